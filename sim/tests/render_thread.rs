//! Pictures on request show the requested tick, drawn outside the ticks, and the
//! foresight equals what the world then does.

use std::time::Duration;

use shm_config::Message;
use shm_config::config::Config;
use shm_config::message::{
    Foresight, Frame, FrameRequest, Header, Observation, Outcome, Outlook, Proposal, View,
};
use shm_config::run::{RunName, RunPaths};
use shm_config::services::{FORESIGHT, FRAME, FRAME_REQUEST, Process};
use shm_config::wire::{Publisher, Subscriber, Wire};
use sim::render::{Renderer, Shot};
use sim::render_thread::{
    HORIZON_S, LogWriter, Move, RenderThread, Replica, Seen, action_log, outlook,
};
use sim::{World, WorldConfig};
use vehicle::Action;

use crate::drivers::{self, Noise};

fn observed(world: &World, passed: f64) -> Box<Observation> {
    let mut observation = Box::default();
    world.observe_between(passed, &mut observation);
    observation
}

/// The instants of an episode at its own rate: moves of one to five sub-steps between
/// two instants, as a world with random stalls makes them.
fn drive(
    world: &mut World,
    (writer, noise): (&mut LogWriter, &mut Noise),
    (episode, seed): (u32, u64),
    ticks: std::ops::Range<u64>,
) -> Vec<(u64, World)> {
    world.reset(seed).expect("a map");
    writer.begin(episode, seed);
    let mut known = Vec::new();
    for tick in ticks {
        writer.saw(Seen {
            tick,
            taken_ns: tick * 1000,
            passed: 0.0,
        });
        known.push((tick, world.clone()));
        let action = match tick % 7 {
            0 => noise.action(),
            _ => drivers::keep_lane(&observed(world, 0.0)),
        };
        let substeps = 1 + tick % 5;
        writer.moved(Move { action, substeps });
        for _ in 0..substeps {
            world.substep(action);
        }
    }
    known
}

fn asked(tick: u64) -> Header {
    Header {
        tick,
        ..Header::default()
    }
}

#[test]
fn a_replica_is_the_world_at_every_tick_in_any_order() {
    let mut world = World::new(WorldConfig::default()).expect("a world");
    let mut replica = Replica::new(WorldConfig::default()).expect("a world");
    let (mut writer, mut log) = action_log();
    let mut noise = Noise(5);
    let mut known = drive(&mut world, (&mut writer, &mut noise), (0, 1000), 0..150);
    log.drain();
    known.extend(drive(
        &mut world,
        (&mut writer, &mut noise),
        (1, 1004),
        150..300,
    ));
    log.drain();
    let mut maps = 0;
    let order = [0, 3, 149, 20, 21, 150, 299, 40, 298, 160];
    for tick in order {
        let (_, world) = &known[tick];
        let episode = u32::from(tick >= 150);
        let episode_log = log.episode(episode).expect("the episode");
        let reached = replica
            .reach(episode_log, &asked(tick as u64), |_| maps += 1)
            .expect("a map");
        let (twin, seen) = reached.expect("the tick");
        assert_eq!(
            (seen.tick, seen.taken_ns),
            (tick as u64, tick as u64 * 1000)
        );
        for passed in [0.0, 0.5] {
            assert_eq!(
                observed(twin, passed),
                observed(world, passed),
                "tick {tick}"
            );
        }
        assert!(twin.bodies().eq(world.bodies()), "tick {tick}");
        assert_eq!(twin.seed(), world.seed());
    }
    assert_eq!(maps, 4, "a map is looked at when the episode is another");
    let episode_log = log.episode(1).expect("the episode");
    assert!(
        replica
            .reach(episode_log, &asked(300), |_| ())
            .expect("a map")
            .is_none()
    );
}

/// What the world itself does with a held action, tick by tick.
fn held(mut world: World, action: Action) -> Outlook {
    let began = world.completion();
    let (mut contact_s, mut out_s) = (HORIZON_S, HORIZON_S);
    for tick in 1..=(HORIZON_S / 0.1).round() as u64 {
        let step = world.step(action);
        let passed_s = tick as f64 / 10.0;
        if (step.touch.vehicle || step.touch.object) && contact_s == HORIZON_S {
            contact_s = passed_s;
        }
        if step.outcome == Outcome::OutOfRoad {
            out_s = passed_s;
        }
        if step.has_ended() {
            break;
        }
    }
    Outlook {
        contact_s,
        out_s,
        completion: world.completion() - began,
    }
}

#[test]
fn foresight_is_what_the_world_then_does() {
    let mut world = World::new(WorldConfig::default()).expect("a world");
    let mut noise = Noise(11);
    let (mut contacts, mut outs, mut clear) = (0, 0, 0);
    for seed in 1000..1040 {
        world.reset(seed).expect("a map");
        for tick in 0..160 {
            if world.last_step().has_ended() {
                break;
            }
            if tick % 10 == 9 {
                let straight = Action {
                    steer: 0.0,
                    pedal: 0.6,
                };
                for action in [straight, noise.action()] {
                    let (told, came) = (outlook(&world, action), held(world.clone(), action));
                    let what = format!("seed {seed}, tick {tick}, {action:?}: {told:?}, {came:?}");
                    assert!((told.contact_s - came.contact_s).abs() < 1e-9, "{what}");
                    assert!((told.out_s - came.out_s).abs() < 1e-9, "{what}");
                    assert_eq!(told.completion, came.completion, "{what}");
                    contacts += u32::from(told.contact_s < HORIZON_S);
                    outs += u32::from(told.out_s < HORIZON_S);
                    clear += u32::from(told.contact_s.min(told.out_s) == HORIZON_S);
                }
            }
            world.step(drivers::keep_lane(&observed(&world, 0.0)));
        }
    }
    assert!(
        contacts > 20 && outs > 20 && clear > 20,
        "{contacts} contacts, {outs} exits, {clear} neither"
    );
}

/// A run of this test; its folder is removed with it.
struct TestRun(RunName);

impl Drop for TestRun {
    fn drop(&mut self) {
        let paths = RunPaths::new(self.0.clone());
        let _ = paths.clean_if_dead();
        paths.remove_dir();
    }
}

/// A gate's ports.
struct Gate {
    requests: Publisher<FrameRequest>,
    frames: Subscriber<Frame>,
    foresights: Subscriber<Foresight>,
    _wire: Wire,
    // Dropped last, when no process is a member.
    run: TestRun,
}

/// A frame copied from shared memory.
struct Print {
    header: Header,
    camera: shm_config::message::Camera,
    size_px: [u32; 2],
    rgb: Vec<u8>,
}

impl Gate {
    fn new() -> Gate {
        let name: RunName = format!("t{}-photos", std::process::id())
            .parse()
            .expect("a name");
        let wire = Wire::join(&name, Process::Gate).expect("shared memory");
        Gate {
            run: TestRun(name),
            requests: wire.publisher(FRAME_REQUEST).expect("a port"),
            frames: wire.subscriber(FRAME).expect("a port"),
            foresights: wire.subscriber(FORESIGHT).expect("a port"),
            _wire: wire,
        }
    }

    fn ask(&mut self, request: FrameRequest) {
        self.requests.update_connections();
        assert!(self.requests.send(&mut request.clone()));
    }

    /// The next frame; `None` when none arrives within `looks` polls of 2 ms.
    fn frame(&mut self, looks: u32) -> Option<Print> {
        for _ in 0..looks {
            self.frames.update_connections();
            self.foresights.update_connections();
            let print = self.frames.visit(|frame| {
                assert_eq!(frame.check(), Ok(()));
                Print {
                    header: frame.header,
                    camera: frame.camera,
                    size_px: [frame.width, frame.height],
                    rgb: frame.rgb().to_vec(),
                }
            });
            if print.is_some() {
                return print;
            }
            std::thread::park_timeout(Duration::from_millis(2));
        }
        None
    }

    fn foresight(&mut self) -> Foresight {
        for _ in 0..LOOKS {
            if let Some(foresight) = self.foresights.newest(Message::check) {
                assert_eq!(foresight.check(), Ok(()));
                return foresight;
            }
            std::thread::park_timeout(Duration::from_millis(2));
        }
        panic!("no foresight came");
    }
}

/// Polls of 2 ms for what must arrive, and for what must not.
const LOOKS: u32 = 10_000;
const NO_LOOKS: u32 = 100;

fn request(episode: u32, tick: u64, view: View) -> FrameRequest {
    let proposal = |steer| Proposal::new(Some(Action { steer, pedal: 0.4 }));
    FrameRequest {
        header: Header {
            tick,
            episode,
            ..Header::default()
        },
        proposals: [proposal(0.0), proposal(0.5)],
        view: view.code(),
        width: 320,
        height: 240,
        ..FrameRequest::default()
    }
}

#[test]
fn a_gate_gets_the_picture_of_the_tick_it_asks_for() {
    let mut gate = Gate::new();
    let mut config = Config::default();
    config.run.name = gate.run.0.to_string();
    let (render_thread, mut writer) = RenderThread::start(&config).expect("a thread");
    let mut world = World::new(WorldConfig::from(&config)).expect("a world");
    let mut noise = Noise(3);
    let known = drive(&mut world, (&mut writer, &mut noise), (4, 1007), 70..220);
    let mut renderer = Renderer::default();
    for (tick, view) in [(219, View::Ego), (100, View::TopDown), (101, View::Ego)] {
        let asked = request(4, tick, view);
        gate.ask(asked);
        let print = gate.frame(LOOKS).expect("a frame");
        let header = print.header;
        assert_eq!(
            (header.tick, header.episode, header.taken_ns),
            (tick, 4, tick * 1000)
        );
        let (_, world) = &known[(tick - 70) as usize];
        renderer.begin(world);
        let shot = Shot {
            view,
            size_px: [320, 240],
            passed: 0.0,
        };
        let picture = renderer.draw(world, &shot).expect("a picture");
        assert_eq!(
            (print.camera, print.size_px),
            (picture.camera, picture.size_px)
        );
        assert!(print.rgb == picture.rgb, "tick {tick}, {view}");
        let foresight = gate.foresight();
        assert_eq!((foresight.header.tick, foresight.header.episode), (tick, 4));
        let actions = asked.actions().expect("both");
        assert_eq!(
            foresight.outlooks,
            actions.map(|action| outlook(world, action))
        );
    }
    // An unknown tick or an invalid request gets no answer.
    let mut bad = request(4, 100, View::Ego);
    bad.width = 5000;
    for nothing in [request(4, 220, View::Ego), request(5, 100, View::Ego), bad] {
        gate.ask(nothing);
        assert!(gate.frame(NO_LOOKS).is_none());
    }
    // Without proposals only the picture is sent.
    let mut plain = request(4, 100, View::TopDown);
    plain.proposals[1] = Proposal::default();
    gate.ask(plain);
    assert_eq!(gate.frame(LOOKS).map(|print| print.header.tick), Some(100));
    drop(render_thread);
    assert_eq!(gate.foresights.newest(Message::check), None);
}
