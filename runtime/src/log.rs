//! The log of a process: its threads queue lines, and one thread without privileges writes
//! them, so no disk delays a process.

use std::io::{self, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

use shm_config::text::Printable;

use crate::kernel::set_ordinary;

/// Lines that wait for the disk at most. A process writes a few lines a second; a policy
/// file or a judge that fails in every tick stays below a hundred.
const WAITING_LINES: usize = 4096;
/// How long an ending process waits for its lines to be written.
const END: Duration = Duration::from_secs(1);
/// How often an ending process tries to queue the end behind lines that wait.
const RETRY: Duration = Duration::from_millis(5);

/// The logging thread; dropping it writes out the queued lines when the process ends.
pub(crate) struct Logs {
    queue: Arc<Queue>,
    written: Receiver<()>,
}

impl Logs {
    /// Starts the thread, and makes it the destination of this process's log.
    ///
    /// # Errors
    /// When the system has no thread left.
    pub(crate) fn start() -> io::Result<Self> {
        let logs = Self::to(Printable(io::stderr()))?;
        tracing_subscriber::fmt()
            .with_writer(logs.queue.clone())
            .with_ansi(false)
            .with_target(false)
            .with_env_filter(
                tracing_subscriber::EnvFilter::try_from_env("VLAPS_LOG")
                    // Zenoh, in a ROS robot's world, repeats its lines for each attempt to
                    // connect; the world tells the first.
                    .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new("info,zenoh=off")),
            )
            .init();
        Ok(logs)
    }

    fn to(file: impl Write + Send + 'static) -> io::Result<Self> {
        let (lines, waiting) = sync_channel(WAITING_LINES);
        // Never sent to: the thread's end closes it.
        let (end, written) = sync_channel(0);
        let queue = Arc::new(Queue {
            lines,
            lost: AtomicU64::new(0),
        });
        let shared = queue.clone();
        thread::Builder::new().name("log".into()).spawn(move || {
            let _end = end;
            write_lines(file, &waiting, &shared);
        })?;
        Ok(Self { queue, written })
    }
}

impl Drop for Logs {
    /// Without real-time priority: this thread could otherwise keep the logging thread,
    /// which has no privileges, from the core, and both would wait for as long as the
    /// kernel lets a real-time thread run.
    fn drop(&mut self) {
        set_ordinary();
        let since = Instant::now();
        while let Err(TrySendError::Full(_)) = self.queue.lines.try_send(Message::End)
            && since.elapsed() < END
        {
            thread::sleep(RETRY);
        }
        let left = END.saturating_sub(since.elapsed());
        // A disk that hangs must not keep the process.
        let _: Result<(), RecvTimeoutError> = self.written.recv_timeout(left);
    }
}

enum Message {
    Line(Vec<u8>),
    End,
}

/// The lines that wait. A line that finds the queue full is dropped and counted.
struct Queue {
    lines: SyncSender<Message>,
    lost: AtomicU64,
}

impl Write for &Queue {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        if self.lines.try_send(Message::Line(line.to_vec())).is_err() {
            self.lost.fetch_add(1, Ordering::Relaxed);
        }
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

fn write_lines(mut file: impl Write, waiting: &Receiver<Message>, queue: &Queue) {
    while let Ok(Message::Line(line)) = waiting.recv() {
        // A full disk is no reason to end: it may have room for the next line.
        let _ = file.write_all(&line);
        let lost = queue.lost.swap(0, Ordering::Relaxed);
        if lost > 0 {
            let line = format!("{lost} lines of this log are lost: the disk is slow\n");
            let _ = file.write_all(line.as_bytes());
        }
    }
    let _ = file.flush();
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::{Sender, channel};

    use shm_config::message::Scheduling;

    use super::*;
    use crate::kernel::{own_scheduling, set_fifo};

    /// A file that takes a line whenever it may.
    struct Gated {
        may: Receiver<()>,
        taken: Sender<String>,
    }

    impl Write for Gated {
        fn write(&mut self, line: &[u8]) -> io::Result<usize> {
            let _ = self.may.recv();
            let _ = self.taken.send(String::from_utf8_lossy(line).into_owned());
            Ok(line.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    fn log(logs: &Logs, line: &str) {
        let mut queue: &Queue = &logs.queue;
        queue.write_all(line.as_bytes()).expect("it is queued");
    }

    #[test]
    fn a_process_that_ends_waits_for_its_log_without_privileges() {
        if set_fifo(1).is_err() {
            println!("skipped: the log of a real-time thread: no real-time priority here");
            return;
        }
        assert_eq!(own_scheduling().0, Scheduling::Fifo);
        drop(Logs::to(io::sink()).expect("a thread"));
        assert_eq!(own_scheduling(), (Scheduling::Ordinary, 0));
    }

    #[test]
    fn a_disk_that_hangs_delays_no_line_and_the_lost_ones_are_counted() {
        let (permit, may) = channel();
        let (taken, lines) = channel();
        let logs = Logs::to(Gated { may, taken }).expect("a thread");
        let many = WAITING_LINES + 10;
        for line in 0..many {
            // Would wait for ever here if it waited for the disk.
            log(&logs, &format!("{line}\n"));
        }
        drop(permit);
        drop(logs);
        let lines: String = lines.iter().collect();
        let lost = lines.lines().find(|line| line.contains("are lost"));
        let lost: usize = lost
            .and_then(|line| line.split(' ').next()?.parse().ok())
            .expect("the number of lost lines");
        let written = lines.lines().count() - 1;
        assert_eq!(written + lost, many);
        // One may be in the thread's hands.
        assert!(lost == 9 || lost == 10, "{lost}");
    }

    #[test]
    fn a_process_ends_although_its_disk_hangs() {
        let (_permit, may) = channel();
        let (taken, lines) = channel();
        let logs = Logs::to(Gated { may, taken }).expect("a thread");
        log(&logs, "a line\n");
        drop(logs);
        assert_eq!(lines.try_iter().count(), 0);
    }
}
