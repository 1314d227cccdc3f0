//! The cores that this process may use, those with most device interrupts first.

use std::fs;

use rustix::thread::{CpuSet, sched_getaffinity};

/// The cores that this process may use, sorted by the interrupts of devices that they have
/// served since the machine started, most first; among equals, lower numbers first. Empty
/// when the kernel reports no affinity.
pub fn own_cores() -> Vec<usize> {
    let Ok(allowed) = sched_getaffinity(None) else {
        return Vec::new();
    };
    let served = served(&fs::read_to_string("/proc/interrupts").unwrap_or_default());
    let mut cores: Vec<usize> = (0..CpuSet::MAX_CPU)
        .filter(|core| allowed.is_set(*core))
        .collect();
    cores.sort_by_key(|&core| {
        let count = served.iter().find(|(of, _)| *of == core);
        std::cmp::Reverse(count.map_or(0, |(_, count)| *count))
    });
    cores
}

/// Parses the interrupts of devices by core from `/proc/interrupts`: a heading with the
/// cores, then a line for each interrupt with a column for each core. Numbered lines are
/// devices; the others, such as the timer's, occur on every core.
fn served(text: &str) -> Vec<(usize, u64)> {
    let mut lines = text.lines();
    let heading = lines.next().unwrap_or_default().split_whitespace();
    let mut cores: Vec<(usize, u64)> = heading
        .filter_map(|word| Some((word.strip_prefix("CPU")?.parse().ok()?, 0)))
        .collect();
    for line in lines {
        let Some((label, counts)) = line.split_once(':') else {
            continue;
        };
        if label.trim().parse::<u32>().is_err() {
            continue;
        }
        for ((_, all), count) in cores.iter_mut().zip(counts.split_whitespace()) {
            *all += count.parse().unwrap_or(0);
        }
    }
    cores
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn devices_are_counted_by_core_and_nothing_else_is() {
        let text = "           CPU0       CPU2
 24:          1          0  IO-APIC   5-edge      ACPI:Ged
 36:          2   18781647 PCI-MSIX-0000:00:02.0   1-edge      virtio1-req.0
LOC:   37174417   36356575   Local timer interrupts
ERR:          0
";
        assert_eq!(served(text), [(0, 3), (2, 18_781_647)]);
        assert_eq!(served(""), []);
        assert_eq!(served("what is this\n 1: 2 3\n"), []);
    }

    #[test]
    fn every_core_is_there_once() {
        let mut cores = own_cores();
        assert!(!cores.is_empty());
        cores.sort_unstable();
        let count = cores.len();
        cores.dedup();
        assert_eq!(cores.len(), count);
    }
}
