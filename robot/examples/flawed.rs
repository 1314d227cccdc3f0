//! A car in an open field with a flaw, for the tests of `./vlaps conform`: each flaw breaks
//! promises that the test has to report. `VLAPS_FLAW` names it; without one the car is
//! sound.

use std::process::ExitCode;

use clap::Parser;
use robot::clock::Begin;
use robot::driven::Driven;
use robot::process::run;
use robot::{Action, Bicycle, Observation, Point, Reading, Robot, Status, scan};
use runtime::{Arguments, Member, SetUpError, exit_code};
use shm_config::services::Process;
use shm_config::time::monotonic;

#[derive(Clone, Copy, PartialEq, Eq)]
enum Flaw {
    None,
    /// Its wheels turn the other way.
    WrongWay,
    /// It goes on when it is told to brake.
    NeverBrakes,
    /// It obeys commands of any age.
    Patient,
    /// Its instants are not those of the run's grid.
    OffGrid,
    /// Each tenth range is not a number.
    NanRanges,
    /// It shows one beam less than the run's scanner has.
    OneBeamLess,
    /// It ends with exit code 3.
    BadEnd,
    /// It ends before it is ready.
    DiesAtStart,
}

struct Car {
    bicycle: Bicycle,
    flaw: Flaw,
    last: Action,
}

impl Robot for Car {
    fn begin(&mut self, _seed: u64) -> Result<(), String> {
        self.bicycle.place(Point::origin(), 0.0);
        Ok(())
    }

    fn obey(&mut self, action: Action, step_s: f64) {
        self.last = action;
        let steer = match self.flaw {
            Flaw::WrongWay => -action.steer,
            _ => action.steer,
        };
        self.bicycle.advance(Action { steer, ..action }, step_s);
    }

    fn brake(&mut self, step_s: f64) {
        match self.flaw {
            Flaw::NeverBrakes => self.obey(self.last, step_s),
            _ => self.obey(Action::BRAKE, step_s),
        }
    }

    fn read(&mut self, observation: &mut Observation) -> Reading {
        self.bicycle.fill(&mut observation.ego);
        observation.road.left_m = 5.0;
        observation.road.right_m = 5.0;
        for (checkpoint, ahead_m) in observation.checkpoints.iter_mut().zip([20.0, 40.0]) {
            checkpoint.x_body_m = ahead_m;
        }
        scan(observation, |_| f64::INFINITY);
        if self.flaw == Flaw::NanRanges {
            observation
                .ranges_m
                .iter_mut()
                .step_by(10)
                .for_each(|range| *range = f32::NAN);
        }
        if self.flaw == Flaw::OneBeamLess {
            observation.beam_count -= 1;
        }
        Reading::Fresh
    }

    fn status(&self) -> Status {
        Status::default()
    }
}

#[derive(Parser)]
struct Cli {
    #[command(flatten)]
    arguments: Arguments,
    #[command(flatten)]
    begin: Begin,
}

fn flaw() -> Result<Flaw, SetUpError> {
    let Some(word) = std::env::var_os("VLAPS_FLAW") else {
        return Ok(Flaw::None);
    };
    Ok(match word.to_string_lossy().as_ref() {
        "wrong-way" => Flaw::WrongWay,
        "never-brakes" => Flaw::NeverBrakes,
        "patient" => Flaw::Patient,
        "off-grid" => Flaw::OffGrid,
        "nan-ranges" => Flaw::NanRanges,
        "one-beam-less" => Flaw::OneBeamLess,
        "bad-end" => Flaw::BadEnd,
        "dies-at-start" => Flaw::DiesAtStart,
        other => return Err(SetUpError::Own(format!("VLAPS_FLAW={other}: no such flaw"))),
    })
}

#[allow(clippy::disallowed_methods)] // a process entry point chooses the clock
fn drive(cli: &Cli, flaw: Flaw) -> Result<(), SetUpError> {
    let mut member = Member::join(Process::World, &cli.arguments, monotonic)?;
    match flaw {
        // The phase of the grid follows from the run's name.
        Flaw::OffGrid => member.config.run.name.push('x'),
        Flaw::Patient => member.config.limits.command_age_ms = 1e9,
        _ => {}
    }
    let car = Car {
        bicycle: Bicycle::new(member.config.vehicle),
        flaw,
        last: Action::BRAKE,
    };
    let driven = Driven::new(car, &member.config);
    run(member, driven, cli.begin)
}

fn main() -> ExitCode {
    let flaw = match flaw() {
        Ok(Flaw::DiesAtStart) => panic!("no lidar on /dev/ttyS7"),
        Ok(flaw) => flaw,
        Err(error) => return exit_code(Process::World, Err(error)),
    };
    match (flaw, exit_code(Process::World, drive(&Cli::parse(), flaw))) {
        (Flaw::BadEnd, _) => ExitCode::from(3),
        (_, code) => code,
    }
}
