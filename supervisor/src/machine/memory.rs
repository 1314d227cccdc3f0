//! The memory of a process as the kernel reports it. It is read from outside and costs no
//! tick any time.

use std::fs;

/// Memory of one process, bytes; each field the maximum observed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Memory {
    /// Peak resident memory of all kinds.
    pub resident: u64,
    /// The part that is anonymous: heap and stacks.
    pub anonymous: u64,
    /// The part that is mapped from files: programs and libraries, shared with others.
    pub file: u64,
    /// The part in shared memory: messages, shared with others.
    pub shared: u64,
}

impl Memory {
    /// The memory of a living process; `None` when it has ended.
    pub fn of(pid: u32) -> Option<Self> {
        Self::parse(&fs::read_to_string(format!("/proc/{pid}/status")).ok()?)
    }

    /// Parses `/proc/PID/status`, proc(5); `None` without memory lines, as of a process that
    /// has ended.
    pub fn parse(status: &str) -> Option<Self> {
        let bytes = |key: &str| {
            let line = status.lines().find_map(|line| line.strip_prefix(key))?;
            let number = line.trim().strip_suffix(" kB")?;
            number.trim().parse::<u64>().ok().map(|kb| kb << 10)
        };
        Some(Self {
            resident: bytes("VmHWM:")?,
            anonymous: bytes("RssAnon:")?,
            file: bytes("RssFile:")?,
            shared: bytes("RssShmem:")?,
        })
    }

    /// The maximum of each field.
    #[must_use]
    pub fn max(self, other: Self) -> Self {
        Self {
            resident: self.resident.max(other.resident),
            anonymous: self.anonymous.max(other.anonymous),
            file: self.file.max(other.file),
            shared: self.shared.max(other.shared),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_status_is_read_in_bytes_and_the_dead_have_none() {
        let status = "Name:\tvlaps\nVmHWM:\t   16000 kB\nVmRSS:\t   12000 kB\n\
                      RssAnon:\t    2000 kB\nRssFile:\t    9000 kB\nRssShmem:\t    1000 kB\n";
        let memory = Memory::parse(status).expect("a living process");
        assert_eq!(memory.resident, 16_384_000);
        assert_eq!(memory.anonymous + memory.file + memory.shared, 12_288_000);
        assert_eq!(Memory::parse("Name:\tvlaps\nState:\tZ (zombie)\n"), None);
        assert!(Memory::of(std::process::id()).is_some_and(|memory| memory.resident > 0));
    }
}
