//! The checks of the machine.

use std::fs;

use shm_config::config::Config;
use shm_config::message::Grant;

use super::finding::{Finding, Grade};
use super::grants;
use crate::machine::cores::own_cores;
use crate::machine::idle::IdleBound;
use crate::run::shared_memory::{Need, check_shared_memory, shared_memory};
use crate::set::privileges::{CORES_MIN, CORES_SHARED};

pub(super) fn memory() -> Finding {
    let what = "shared memory";
    let need = Need::of(&Config::default());
    let looked = shared_memory().and_then(|(free, total)| {
        check_shared_memory(free, &need)?;
        Ok((free, total))
    });
    match looked {
        Ok((free, total)) => Finding {
            what,
            grade: Grade::Ok,
            found: format!(
                "/dev/shm: {} MB free of {} MB; a run needs {need}",
                free >> 20,
                total >> 20
            ),
            remedy: Vec::new(),
        },
        Err(failure) => Finding {
            what,
            grade: Grade::Fatal,
            found: failure.to_string(),
            remedy: Vec::new(),
        },
    }
}

pub(super) fn cores() -> Finding {
    let count = own_cores().len();
    let meanwhile = match count {
        ..CORES_SHARED => "the kernel places the processes; use a larger machine",
        _ => "they share one that the kernel gives to others when they sleep; use a larger machine",
    };
    Finding::new(
        "cores",
        count >= CORES_MIN,
        format!("{count} usable; {CORES_MIN} give world, planner and controller one each"),
        &[meanwhile],
    )
}

/// Cores that the kernel reserves for threads that are pinned to them.
pub(super) fn isolated() -> Finding {
    let cores = read("/sys/devices/system/cpu/isolated").unwrap_or_default();
    let found = match cores.is_empty() {
        true if own_cores().len() < CORES_MIN => {
            "none, and too few cores for a core of its own for each process".into()
        }
        true => "none; everything else on the machine runs beside the ticks".into(),
        false => cores.clone(),
    };
    // With too few cores no process gets its own core, so no core needs to be isolated.
    let is_ok = !cores.is_empty() || own_cores().len() < CORES_MIN;
    let remedy = [
        "boot with `isolcpus=domain,managed_irq,CORES nohz_full=CORES rcu_nocbs=CORES`,",
        "CORES the last three, such as 1-3 of four",
    ];
    Finding::new("isolated cores", is_ok, found, &remedy)
}

pub(super) fn read(path: &str) -> Option<String> {
    fs::read_to_string(path).ok().map(|text| text.trim().into())
}

pub(super) fn kernel() -> Finding {
    let release = read("/proc/sys/kernel/osrelease").unwrap_or_else(|| "unknown".into());
    let version = read("/proc/sys/kernel/version").unwrap_or_default();
    let model = version
        .split_whitespace()
        .find(|word| word.starts_with("PREEMPT"))
        .unwrap_or("no preemption");
    // The words after it come from a file that only root can read.
    let chosen = read("/sys/kernel/debug/sched/preempt").unwrap_or_default();
    // The file exists, and holds 1, only in kernels with PREEMPT_RT.
    let is_rt = read("/sys/kernel/realtime").is_some_and(|text| text == "1");
    let fully = if is_rt {
        "; every part can be preempted"
    } else {
        ""
    };
    Finding::new(
        "kernel",
        model.starts_with("PREEMPT"),
        format!("Linux {release}, {model}{fully} {chosen}")
            .trim_end()
            .into(),
        &[
            "boot a kernel with preemption, best PREEMPT_RT: sudo apt-get install linux-image-rt-amd64",
        ],
    )
}

pub(super) fn throttling() -> Finding {
    let runtime = read("/proc/sys/kernel/sched_rt_runtime_us");
    let runtime_us: Option<i64> = runtime.and_then(|text| text.parse().ok());
    let found = match runtime_us {
        None => "the kernel has no limit to show".into(),
        Some(-1) => "real-time threads may use the whole of a core".into(),
        Some(us) => format!("real-time threads may use {} % of a core", us / 10_000),
    };
    // 95 % is the kernel's default; a tick uses a fraction of it.
    let is_ok = runtime_us.is_none_or(|us| us == -1 || us >= 900_000);
    let remedy = ["sudo sysctl kernel.sched_rt_runtime_us=950000"];
    Finding::new("real-time share", is_ok, found, &remedy)
}

pub(super) fn governor() -> Finding {
    let mut governors: Vec<String> = own_cores()
        .iter()
        .filter_map(|core| {
            read(&format!(
                "/sys/devices/system/cpu/cpu{core}/cpufreq/scaling_governor"
            ))
        })
        .collect();
    governors.sort();
    governors.dedup();
    let found = match governors.is_empty() {
        true => "not in the kernel's hands (a virtual machine or fixed clock)".into(),
        false => governors.join(", "),
    };
    let is_ok = governors.iter().all(|governor| governor == "performance");
    let remedy = ["sudo cpupower frequency-set -g performance"];
    Finding::new("CPU governor", is_ok, found, &remedy)
}

pub(super) fn sleep() -> Finding {
    let driver = read("/sys/devices/system/cpu/cpuidle/current_driver").unwrap_or_default();
    let is_ok = IdleBound::ask(0).grant() == Grant::Granted;
    let can = match is_ok {
        true => "a set can keep the processors from sleeping",
        false => "a set cannot keep the processors from sleeping",
    };
    let found = match driver.as_str() {
        "" | "none" => format!("{can}; no idle driver"),
        driver => format!("{can}; idle driver {driver}"),
    };
    Finding::new(
        "processor sleep",
        is_ok,
        found,
        &grants::cpu_latency_lines(),
    )
}

pub(super) fn clock_source() -> Finding {
    let folder = "/sys/devices/system/clocksource/clocksource0";
    let current = read(&format!("{folder}/current_clocksource"));
    let available = read(&format!("{folder}/available_clocksource")).unwrap_or_default();
    let name = current.unwrap_or_else(|| "unknown".into());
    // These clocks are read over a bus, which takes microseconds each time.
    let is_ok = !["hpet", "acpi_pm", "jiffies"].contains(&name.as_str());
    let remedy = [
        "boot with `tsc=reliable` if the processor's counter is constant",
        "(grep constant_tsc /proc/cpuinfo)",
    ];
    let found = format!("{name} (available: {available})");
    Finding::new("clock source", is_ok, found, &remedy)
}
