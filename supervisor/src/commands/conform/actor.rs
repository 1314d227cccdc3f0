//! The scripted controller: a process of its own, because a world tells processes apart
//! by their ids, and because it is killed and replaced.

use std::io::{BufRead, Write};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::thread;
use std::time::Duration;

use shm_config::message::{Command as DriveCommand, Observation};
use shm_config::run::RunName;
use shm_config::services::{COMMAND, OBSERVATION, Process};
use shm_config::wire::Wire;

use super::order::Order;
use crate::Clock;
use crate::cli::failure::Failure;
use crate::machine::signals::pause;

/// Time between two looks at the observations and at the orders: two thousandths of the
/// tightest age limit of a world at 10 Hz, and less than a tick at 100 Hz.
const LOOK: Duration = Duration::from_millis(2);

/// The body of the process: answers each observation as the last line of its input says,
/// until its input ends.
///
/// # Errors
/// When shared memory refuses.
pub(super) fn act(run: &RunName, clock: Clock) -> Result<(), Failure> {
    let wire = Wire::join(run, Process::Controller)?;
    let mut observations = wire.subscriber::<Observation>(OBSERVATION)?;
    let mut commands = wire.publisher::<DriveCommand>(COMMAND)?;
    let orders = orders();
    let mut order = Order::Silence;
    loop {
        match orders.try_recv() {
            Ok(next) => order = next,
            Err(TryRecvError::Empty) => {}
            Err(TryRecvError::Disconnected) => return Ok(()),
        }
        observations.update_connections();
        commands.update_connections();
        if let Some(seen) = observations.newest(|_| Ok(()))
            && let Some(mut command) = order.command(seen.header, clock())
        {
            commands.send(&mut command);
        }
        pause(LOOK);
    }
}

/// The orders of the standard input, from a thread that blocks on it.
fn orders() -> Receiver<Order> {
    let (send, orders) = channel();
    thread::spawn(move || {
        for line in std::io::stdin().lock().lines() {
            let Ok(line) = line else { return };
            let Ok(order) = line.parse();
            if send.send(order).is_err() {
                return;
            }
        }
    });
    orders
}

/// A scripted controller that runs. Dropping it kills it.
pub(super) struct Actor {
    child: Child,
    order: Order,
}

impl Actor {
    /// Starts one that is silent.
    ///
    /// # Errors
    /// When this program cannot be started again.
    pub(super) fn start(run: &RunName) -> Result<Self, Failure> {
        let failed = |error| Failure::GivenUp(format!("cannot start a controller: {error}"));
        let program = std::env::current_exe().map_err(failed)?;
        let child = Command::new(program)
            .args(["conform", "--act", &run.to_string()])
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .map_err(failed)?;
        Ok(Self {
            child,
            order: Order::Silence,
        })
    }

    /// Its process id.
    pub(super) fn pid(&self) -> u32 {
        self.child.id()
    }

    /// Gives it an order.
    ///
    /// # Errors
    /// When it has ended.
    pub(super) fn order(&mut self, order: Order) -> Result<(), Failure> {
        if order == self.order {
            return Ok(());
        }
        self.order = order;
        let failed = |error| Failure::GivenUp(format!("the scripted controller: {error}"));
        match self.child.stdin.as_mut() {
            Some(input) => writeln!(input, "{order}").map_err(failed),
            None => Ok(()),
        }
    }
}

impl Drop for Actor {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
