//! The asking and the answering process, and the protocol between them.

use std::io::{BufRead, BufReader, Write};
use std::os::unix::process::CommandExt;
use std::process::ExitCode;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use supervisor::subcommand::{Output, Subcommand};

use anyhow::{Context, anyhow, bail};
use clap::ValueEnum;
use shm_config::message::{Advice, Command as Driven, Observation, Plan, Step};
use shm_config::run::RunName;
use shm_config::wire::Wire;

use super::arguments::{IpcEcho, MessageChoice, Wake};
use super::bare::Bare;
use super::link::{RoundTrips, echo};
use super::port::{Check, End, Measured, Port};
use crate::floor::{Priority, claim, stay_on};
use stack::Clock;
use supervisor::subcommand::say;

/// The sides of the comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Side {
    /// The stack's port.
    Port,
    /// The stack's port without the check on receipt.
    Open,
    /// Bare iceoryx2 with the same bytes.
    Bare,
    /// Bare iceoryx2 with 8 bytes.
    Tiny,
}

/// One end of all connections for one message type.
pub struct Ends<M: Measured> {
    /// Through the stack's port.
    pub port: Port<M>,
    /// Through bare iceoryx2.
    pub bare: Bare<M>,
    /// Through bare iceoryx2, with 8 bytes.
    pub tiny: Bare<u64>,
}

impl<M: Measured> Ends<M> {
    /// Opens all connections.
    ///
    /// # Errors
    /// If shared memory refuses.
    pub fn open(wire: &Wire, run: &RunName, end: End, wake: Wake) -> anyhow::Result<Self> {
        let bare = format!("bare/{}/{}", M::WORD, wake.word());
        let tiny = format!("{bare}/tiny");
        Ok(Self {
            port: Port::open(wire, end, wake)?,
            bare: Bare::open(run, &bare, (end, wake), M::full())?,
            tiny: Bare::open(run, &tiny, (end, wake), 0)?,
        })
    }
}

/// Requests real-time priority for a sleeping receiver, as the stack's processes do. A
/// spinning one gets none: the kernel would throttle it.
pub fn claim_for(wake: Wake) -> &'static str {
    match wake {
        Wake::Spin => claim(Priority::Ordinary),
        Wake::Bell | Wake::Grid => claim(Priority::Asked),
    }
}

/// The answering process, as seen by the asking one.
pub struct Echo {
    child: Child,
    orders: Option<ChildStdin>,
    answers: BufReader<ChildStdout>,
}

impl Echo {
    /// Starts it.
    ///
    /// # Errors
    /// If this program cannot be started a second time.
    pub fn start(run: &RunName, core: Option<usize>) -> anyhow::Result<Self> {
        let program = std::env::current_exe()?;
        let mut child = Command::new(&program)
            .args(["bench", "ipc-echo", &run.to_string()])
            .args(core.map(|core| core.to_string()))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            // Ctrl-C in the terminal is handled by the asking process.
            .process_group(0)
            .spawn()
            .with_context(|| program.display().to_string())?;
        let answers = child.stdout.take().context("no pipe")?;
        Ok(Self {
            orders: child.stdin.take(),
            child,
            answers: BufReader::new(answers),
        })
    }

    /// Sends it one order.
    ///
    /// # Errors
    /// If it has ended.
    pub fn order(&mut self, order: &str) -> anyhow::Result<()> {
        let orders = self.orders.as_mut().context("no pipe")?;
        writeln!(orders, "{order}").context("the answering process has ended")?;
        Ok(())
    }

    /// Waits until it reports that it is ready.
    ///
    /// # Errors
    /// If it reports something else or has ended.
    pub fn await_ready(&mut self) -> anyhow::Result<()> {
        let mut line = String::new();
        self.answers.read_line(&mut line)?;
        match line.trim_end() {
            "ready" => Ok(()),
            "" => bail!("the answering process has ended; its error is above"),
            other => bail!("unexpected answer {other:?} of the answering process"),
        }
    }
}

impl Drop for Echo {
    fn drop(&mut self) {
        // The process ends at the end of its input.
        self.orders = None;
        let _ = self.child.wait();
    }
}

impl Subcommand for IpcEcho {
    fn outputs(&self) -> Vec<Output> {
        Vec::new()
    }

    fn run(&self, clock: Clock) -> anyhow::Result<ExitCode> {
        answer(self, clock)?;
        Ok(ExitCode::SUCCESS)
    }
}

/// `bench ipc-echo`: answers until its input ends.
///
/// # Errors
/// If a message is lost or refused, or an order is invalid.
fn answer(arguments: &IpcEcho, clock: Clock) -> anyhow::Result<()> {
    if let Some(core) = arguments.core {
        stay_on(core);
    }
    let wire = Wire::join(&arguments.run, End::Echo.process())?;
    let mut orders = std::io::stdin().lines();
    while let Some(order) = orders.next() {
        let order = order?;
        let words: Vec<&str> = order.split(' ').collect();
        let ["open", message, wake] = words[..] else {
            bail!("invalid order {order:?}");
        };
        let message = MessageChoice::from_str(message, true).map_err(|error| anyhow!(error))?;
        let wake = Wake::from_str(wake, true).map_err(|error| anyhow!(error))?;
        let run = &arguments.run;
        let orders = &mut orders;
        match message {
            MessageChoice::Observation => serve::<Observation>(&wire, run, wake, orders, clock),
            MessageChoice::Plan => serve::<Plan>(&wire, run, wake, orders, clock),
            MessageChoice::Command => serve::<Driven>(&wire, run, wake, orders, clock),
            MessageChoice::Step => serve::<Step>(&wire, run, wake, orders, clock),
            MessageChoice::Advice => serve::<Advice>(&wire, run, wake, orders, clock),
        }?;
    }
    Ok(())
}

fn serve<M: Measured>(
    wire: &Wire,
    run: &RunName,
    wake: Wake,
    orders: &mut dyn Iterator<Item = std::io::Result<String>>,
    clock: Clock,
) -> anyhow::Result<()> {
    claim_for(wake);
    let mut ends = Ends::<M>::open(wire, run, End::Echo, wake)?;
    say("ready");
    for order in orders {
        let order = order?;
        let words: Vec<&str> = order.split(' ').collect();
        let (side, count) = match words[..] {
            ["go", side, count] => (side, count.parse()?),
            ["close"] => return Ok(()),
            _ => bail!("invalid order {order:?}"),
        };
        let trips = RoundTrips {
            wake,
            period_ns: 0,
            counts: [0, count],
        };
        // Both processes now begin the same block.
        say("ready");
        match Side::from_str(side, true).map_err(|error| anyhow!(error))? {
            Side::Port => {
                ends.port.check = Check::Admit;
                echo(&mut ends.port, trips, clock)
            }
            Side::Open => {
                ends.port.check = Check::Skip;
                echo(&mut ends.port, trips, clock)
            }
            Side::Bare => echo(&mut ends.bare, trips, clock),
            Side::Tiny => echo(&mut ends.tiny, trips, clock),
        }?;
    }
    Ok(())
}
