//! `doctor`: what this machine grants, and how to grant what is missing.
//!
//! Rights are tried, not deduced: a limit that looks sufficient may still be
//! overruled by a container or a control group.

pub mod grants;

use std::fmt;
use std::fs;
use std::thread;

use rustix::mm::MlockAllFlags;
use rustix::process::{Resource, Rlimit, getrlimit};
use shm_config::config::Config;
use shm_config::message::Grant;
use thread_priority::{
    Error, RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id,
};

use crate::Clock;
use crate::cli::failure::Failure;
use crate::commands::down::living_runs;
use crate::commands::status::look;
use crate::machine::cores::own_cores;
use crate::machine::idle::IdleBound;
use crate::run::place::{check_shared_memory, shared_memory};
use crate::run::shared_memory::Need;
use crate::set::table::{CORES_MIN, CORES_SHARED, TABLE, rows};
use crate::show::screen::say;

/// What a finding means.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Grade {
    /// As it should be.
    Ok,
    /// It runs without, less punctually.
    Missing,
    /// It does not run without.
    Fatal,
}

/// One thing looked at.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// What.
    pub what: &'static str,
    /// How it is.
    pub grade: Grade,
    /// What was found.
    pub found: String,
    /// Commands and lines that change it, when it is not as it should be.
    pub remedy: Vec<String>,
}

impl Finding {
    fn new(what: &'static str, is_ok: bool, found: String, remedy: &[impl ToString]) -> Self {
        let remedy = remedy.iter().map(ToString::to_string);
        Self {
            what,
            grade: if is_ok { Grade::Ok } else { Grade::Missing },
            found,
            remedy: remedy.filter(|_| !is_ok).collect(),
        }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let grade = match self.grade {
            Grade::Ok => "OK",
            Grade::Missing | Grade::Fatal => "MISSING",
        };
        write!(f, "{grade:<8} {:<20} {}", self.what, self.found)?;
        for line in &self.remedy {
            write!(f, "\n             {line}")?;
        }
        Ok(())
    }
}

/// Looks at everything and prints it.
///
/// # Errors
/// When something is missing that a run cannot do without.
pub fn doctor(clock: Clock) -> Result<(), Failure> {
    let mut findings = [
        priority(),
        locked_memory(),
        memory(),
        cores(),
        isolated(),
        kernel(),
        throttling(),
        governor(),
        sleep(),
        clock_source(),
    ];
    // One way to grant both is told once.
    if findings[0].remedy == findings[1].remedy && findings[1].grade == Grade::Missing {
        findings[1].remedy = vec!["the same commands grant it".into()];
    }
    for finding in &findings {
        say(finding);
    }
    tell_of_sets(clock);
    let missing = |grade| {
        findings
            .iter()
            .filter(|finding| finding.grade == grade)
            .count()
    };
    let (fatal, poor) = (missing(Grade::Fatal), missing(Grade::Missing));
    if fatal > 0 {
        return Err(Failure::GivenUp(format!(
            "{fatal} of these must be mended before a set can run"
        )));
    }
    say(match poor {
        0 => "a set runs here with everything it asks for".into(),
        _ => format!("a set runs here, less punctually than it could: {poor} missing"),
    });
    Ok(())
}

/// What the threads of running sets asked for, and what they have.
fn tell_of_sets(clock: Clock) {
    let all_cores = cores_list();
    for paths in living_runs() {
        let name = paths.name();
        let Some(supervisor) = paths.supervisor_pid() else {
            continue;
        };
        let (config, tally) = match look(&paths, supervisor, clock) {
            Ok(seen) => seen,
            Err(error) => {
                say(format_args!("\nrun '{name}' cannot be looked at: {error}"));
                continue;
            }
        };
        say(format_args!(
            "\nrun '{name}': thread, scheduling and priority asked / got, own core, cores, slack"
        ));
        for process in rows(&config).map(|row| row.process) {
            let threads = tally
                .process(process)
                .map_or(&[][..], |tally| tally.threads());
            let tick_cores = threads.first().map_or("", |thread| thread.cores.as_str());
            for thread in threads {
                let grade = match thread.is_as_asked(tick_cores, &all_cores) {
                    true => "OK",
                    false => "MISSING",
                };
                let slack = thread
                    .slack_ns
                    .map_or("unknown".into(), |ns| format!("{ns} ns"));
                say(format_args!(
                    "{grade:<8} {process:<11}{:<17}{} {} / {} {}, {}, {}, {slack}",
                    thread.name,
                    thread.scheduling_asked,
                    thread.priority_asked,
                    thread.scheduling_got,
                    thread.priority_got,
                    thread.core,
                    thread.cores
                ));
            }
        }
    }
}

/// The cores that a thread may use that asked for none, as the kernel writes them.
fn cores_list() -> String {
    let status = read("/proc/self/status").unwrap_or_default();
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("Cpus_allowed_list:"));
    line.unwrap_or_default().trim().into()
}

/// The highest priority of the process table.
fn highest_priority() -> u8 {
    TABLE.iter().map(|row| row.priority).max().unwrap_or(0)
}

fn priority() -> Finding {
    let asked = highest_priority();
    // On a thread that ends at once, so that the doctor itself stays ordinary.
    let tried = thread::spawn(move || {
        let priority = ThreadPriorityValue::try_from(asked).map_err(|error| error.to_string())?;
        let priority = ThreadPriority::Crossplatform(priority);
        let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
        set_thread_priority_and_policy(thread_native_id(), priority, policy).map_err(|error| {
            match error {
                Error::OS(code) => std::io::Error::from_raw_os_error(code).to_string(),
                other => format!("{other:?}"),
            }
        })
    })
    .join()
    .unwrap_or_else(|_| Err("the attempt ended in a panic".into()));
    let limit = match getrlimit(Resource::Rtprio).current {
        Some(limit) => limit.to_string(),
        None => "unlimited".into(),
    };
    let by_file = tried.is_err() && grants::programs_can(grants::SYS_NICE);
    let found = match &tried {
        Ok(()) => format!("SCHED_FIFO {asked} granted (RLIMIT_RTPRIO {limit})"),
        Err(_) if by_file => format!("SCHED_FIFO {asked} granted to the programs (capabilities)"),
        Err(error) => format!("SCHED_FIFO {asked} refused: {error} (RLIMIT_RTPRIO {limit})"),
    };
    let is_ok = tried.is_ok() || by_file;
    Finding::new("real-time priority", is_ok, found, &grants::lines())
}

fn locked_memory() -> Finding {
    let tried = rustix::mm::mlockall(MlockAllFlags::CURRENT);
    if tried.is_ok() {
        // The doctor needs none of it.
        let _ = rustix::mm::munlockall();
    }
    let Rlimit { current, .. } = getrlimit(Resource::Memlock);
    let limit = match current {
        Some(bytes) => format!("{} KB", bytes >> 10),
        None => "unlimited".into(),
    };
    let by_file = tried.is_err() && grants::programs_can(grants::IPC_LOCK);
    let found = match tried {
        Ok(()) => format!("granted (RLIMIT_MEMLOCK {limit})"),
        Err(_) if by_file => "granted to the programs (capabilities)".into(),
        Err(error) => format!("refused: {error} (RLIMIT_MEMLOCK {limit})"),
    };
    let is_ok = tried.is_ok() || by_file;
    Finding::new("locked memory", is_ok, found, &grants::lines())
}

fn memory() -> Finding {
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

fn cores() -> Finding {
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

/// Cores that the kernel keeps free for whoever asks for them by number.
fn isolated() -> Finding {
    let cores = read("/sys/devices/system/cpu/isolated").unwrap_or_default();
    let found = match cores.is_empty() {
        true if own_cores().len() < CORES_MIN => {
            "none, and too few cores to give anybody one of its own".into()
        }
        true => "none; everything else on the machine runs beside the ticks".into(),
        false => cores.clone(),
    };
    // With too few cores nobody is given one, and there is nothing to keep free.
    let is_ok = !cores.is_empty() || own_cores().len() < CORES_MIN;
    let remedy = [
        "boot with `isolcpus=domain,managed_irq,CORES nohz_full=CORES rcu_nocbs=CORES`,",
        "CORES the last three, such as 1-3 of four",
    ];
    Finding::new("isolated cores", is_ok, found, &remedy)
}

fn read(path: &str) -> Option<String> {
    fs::read_to_string(path).ok().map(|text| text.trim().into())
}

fn kernel() -> Finding {
    let release = read("/proc/sys/kernel/osrelease").unwrap_or_else(|| "unknown".into());
    let version = read("/proc/sys/kernel/version").unwrap_or_default();
    let model = version
        .split_whitespace()
        .find(|word| word.starts_with("PREEMPT"))
        .unwrap_or("no preemption");
    // The words after it come from a file that only root may read.
    let chosen = read("/sys/kernel/debug/sched/preempt").unwrap_or_default();
    // There, and 1, in kernels with PREEMPT_RT alone.
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

fn throttling() -> Finding {
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

fn governor() -> Finding {
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

fn sleep() -> Finding {
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

fn clock_source() -> Finding {
    let folder = "/sys/devices/system/clocksource/clocksource0";
    let current = read(&format!("{folder}/current_clocksource"));
    let available = read(&format!("{folder}/available_clocksource")).unwrap_or_default();
    let name = current.unwrap_or_else(|| "unknown".into());
    // These are read over a bus on every look at the clock: microseconds.
    let is_ok = !["hpet", "acpi_pm", "jiffies"].contains(&name.as_str());
    let remedy = [
        "boot with `tsc=reliable` if the processor's counter is constant",
        "(grep constant_tsc /proc/cpuinfo)",
    ];
    let found = format!("{name} (available: {available})");
    Finding::new("clock source", is_ok, found, &remedy)
}
