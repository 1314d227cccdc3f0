//! The threads of a running set: the privileges that each asked for, and those in force as
//! the kernel reports them. They are read from outside and cost no tick any time.

use std::fs;

use serde::Serialize;
use shm_config::message::{Grant, Health, Scheduling};

/// One thread.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Thread {
    /// Its name; the tick's thread has the name of its program.
    pub name: String,
    /// Its id.
    pub tid: u32,
    /// Whether it runs the ticks; the other threads are helpers.
    pub is_tick: bool,
    /// The scheduling asked for.
    pub scheduling_asked: &'static str,
    /// The scheduling in force.
    pub scheduling_got: &'static str,
    /// The real-time priority asked for; 0 for none.
    pub priority_asked: u32,
    /// The real-time priority in force; 0 for none.
    pub priority_got: u32,
    /// A core of its own: not asked, granted or refused.
    pub core: &'static str,
    /// The cores it may use, such as `0-3`.
    pub cores: String,
    /// Its timer slack, ns; `None` where the kernel does not report it.
    pub slack_ns: Option<u64>,
}

impl Thread {
    /// Whether it has exactly what it asked for: a helper at the priority or on the core of
    /// the tick's thread would delay the tick.
    pub fn is_as_asked(&self, tick_cores: &str, all_cores: &str) -> bool {
        let scheduled = self.scheduling_asked == self.scheduling_got
            && self.priority_asked == self.priority_got;
        let inherited = !self.is_tick && self.cores == tick_cores && tick_cores != all_cores;
        scheduled && !inherited && self.core != Grant::Refused.word()
    }
}

/// The threads of a living process, the tick's thread first; empty when it has ended. The
/// tick's thread asked for what its health reports. The others ask for nothing: they are
/// expected to be ordinary and free to run on every core.
pub fn threads(pid: u32, health: &Health) -> Vec<Thread> {
    let Ok(entries) = fs::read_dir(format!("/proc/{pid}/task")) else {
        return Vec::new();
    };
    let mut tids: Vec<u32> = entries
        .flatten()
        .filter_map(|entry| entry.file_name().to_str()?.parse().ok())
        .collect();
    tids.sort_by_key(|tid| (*tid != pid, *tid));
    let read = |tid| Some((tid, read_thread(pid, tid)?));
    tids.into_iter()
        .filter_map(read)
        .map(|(tid, said)| said.beside(tid, pid, health))
        .collect()
}

/// A thread as the kernel reports it.
struct KernelThread {
    name: String,
    scheduling: Scheduling,
    priority: u32,
    cores: String,
    slack_ns: Option<u64>,
}

fn read_thread(pid: u32, tid: u32) -> Option<KernelThread> {
    let folder = format!("/proc/{pid}/task/{tid}");
    let stat = fs::read_to_string(format!("{folder}/stat")).ok()?;
    let status = fs::read_to_string(format!("{folder}/status")).ok()?;
    let (name, scheduling, priority) = parse_stat(&stat)?;
    let cores = status
        .lines()
        .find_map(|line| line.strip_prefix("Cpus_allowed_list:"))?;
    let slack = fs::read_to_string(format!("/proc/{tid}/timerslack_ns"));
    Some(KernelThread {
        name,
        scheduling,
        priority,
        cores: cores.trim().into(),
        slack_ns: slack.ok().and_then(|text| text.trim().parse().ok()),
    })
}

/// Parses name, scheduling and real-time priority from proc_pid_stat(5), fields 2, 40 and
/// 41. The name is in parentheses and may hold any character.
fn parse_stat(stat: &str) -> Option<(String, Scheduling, u32)> {
    let (begin, end) = (stat.find('(')?, stat.rfind(')')?);
    let mut fields = stat.get(end + 1..)?.split_whitespace();
    // The first one after the name is the third.
    let priority = fields.nth(40 - 3)?.parse().ok()?;
    let policy: i32 = fields.next()?.parse().ok()?;
    let scheduling = match policy {
        // linux/sched.h
        1 => Scheduling::Fifo,
        _ => Scheduling::Ordinary,
    };
    Some((stat.get(begin + 1..end)?.into(), scheduling, priority))
}

impl KernelThread {
    fn beside(self, tid: u32, pid: u32, health: &Health) -> Thread {
        let is_tick = tid == pid;
        let asked = Scheduling::from_code(health.scheduling_asked).filter(|_| is_tick);
        let scheduling_asked = asked.unwrap_or(Scheduling::Ordinary);
        let core = match is_tick {
            true => Grant::from_code(health.core).unwrap_or(Grant::Refused),
            false => Grant::Unasked,
        };
        Thread {
            name: self.name,
            tid,
            is_tick,
            scheduling_asked: scheduling_asked.word(),
            scheduling_got: self.scheduling.word(),
            priority_asked: match scheduling_asked {
                Scheduling::Fifo => health.priority_asked,
                Scheduling::Ordinary => 0,
            },
            priority_got: self.priority,
            core: core.word(),
            cores: self.cores,
            slack_ns: self.slack_ns,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_with_brackets_and_spaces_is_read_whole() {
        let before = "0 ".repeat(37);
        let stat = format!("77 (a) b (c) {before}45 1 0 0");
        let (name, scheduling, priority) = parse_stat(&stat).expect("a stat");
        assert_eq!(
            (name.as_str(), scheduling, priority),
            ("a) b (c", Scheduling::Fifo, 45)
        );
        assert_eq!(parse_stat("77 (short) S 1"), None);
    }

    #[test]
    fn a_helper_on_the_ticks_own_core_is_not_as_asked() {
        let health = Health {
            scheduling_asked: Scheduling::Fifo.code(),
            priority_asked: 45,
            core: Grant::Granted.code(),
            ..Health::default()
        };
        let said = |priority: u32, cores: &str| KernelThread {
            name: "x".into(),
            scheduling: match priority {
                0 => Scheduling::Ordinary,
                _ => Scheduling::Fifo,
            },
            priority,
            cores: cores.into(),
            slack_ns: None,
        };
        let is_right =
            |said: KernelThread, tid| said.beside(tid, 5, &health).is_as_asked("3", "0-3");
        assert!(is_right(said(45, "3"), 5));
        assert!(!is_right(said(0, "3"), 5), "refused priority");
        assert!(is_right(said(0, "0-3"), 6));
        assert!(!is_right(said(0, "3"), 6), "inherited core");
        assert!(!is_right(said(45, "0-3"), 6), "inherited priority");
    }

    #[test]
    fn this_test_is_a_thread_beside_the_first() {
        let pid = std::process::id();
        // While a thread ends, as those of other tests do, the kernel's list may miss another one.
        let mut lists = (0..100)
            .map(|_| threads(pid, &Health::default()))
            .peekable();
        let first = lists.peek().cloned();
        let all = lists.find(|all| all.len() >= 2 && all[0].is_tick);
        let all = all.unwrap_or_else(|| panic!("not the first thread and this one: {first:?}"));
        assert!(
            all[1..]
                .iter()
                .all(|thread| !thread.is_tick && !thread.cores.is_empty())
        );
    }
}
