//! A ROS robot as world, over a router, without a run around it.

mod stage;

use robot::{Action, Observation, Outcome, Reading, Robot as _};
use shm_config::Message as _;
use shm_config::config::Config;
use vlaps_ros::names::TopicType;
use vlaps_ros::settings::Settings;
use vlaps_ros::wall::Moment;
use vlaps_ros::world::RosRobot;
use zenoh::Session;

use stage::{LOST, free_router, hear, odometry, odometry_in, path, put, router, scan};
use stage::{settings, standard, tokens, transform, until};

/// The other side of the topics.
struct Stage {
    router: Session,
    scan: TopicType,
    odometry: TopicType,
    tf: TopicType,
    path: TopicType,
    robot: RosRobot,
    observation: Box<Observation>,
}

impl Stage {
    /// A robot that is connected: what is sent from now on reaches it.
    fn new(change: impl FnOnce(&mut Settings)) -> Self {
        let address = free_router();
        let router = router(&address);
        let mut settings = settings(&address);
        change(&mut settings);
        let config = Config::default();
        let robot = RosRobot::open(&config, &settings).expect("a robot");
        // Scan, odometry, and twice TF.
        let subscriptions = if settings.robot.path.is_empty() { 4 } else { 5 };
        until("the robot has subscribed", || {
            let tokens = tokens(&router);
            let own = tokens.iter().filter(|token| token.contains("/MS/"));
            own.count() == subscriptions
        });
        let mut observation = Box::<Observation>::default();
        observation.set_fan(&config.scanner.fan());
        observation.lidar_max_m = config.scanner.range_m as f32;
        Self {
            router,
            scan: standard("sensor_msgs/LaserScan"),
            odometry: standard("nav_msgs/Odometry"),
            tf: standard("tf2_msgs/TFMessage"),
            path: standard("nav_msgs/Path"),
            robot,
            observation,
        }
    }

    /// Sensors of this moment.
    fn sense(&self, range_m: f32, pose: [f64; 3]) {
        let now_ns = Moment::now().epoch_ns;
        put(
            &self.router,
            "/scan",
            &self.scan,
            &scan(now_ns, "laser", range_m),
        );
        put(
            &self.router,
            "/odom",
            &self.odometry,
            &odometry(now_ns, pose, 1.5),
        );
    }

    fn mount(&self, pose: [f64; 3]) {
        let mount = transform("base_link", "laser", pose);
        put(&self.router, "/tf", &self.tf, &mount);
    }

    fn read(&mut self) -> Reading {
        self.robot.read(&mut self.observation)
    }

    fn path(&self, places: &[[f64; 2]]) {
        put(&self.router, "/plan", &self.path, &path("map", places));
    }

    /// Where the map is in the frame of the odometry.
    fn map(&self, pose: [f64; 3]) {
        let in_map = transform("map", "odom", pose);
        put(&self.router, "/tf", &self.tf, &in_map);
    }

    /// Sends until the robot sees it.
    fn until_fresh(&mut self, range_m: f32, pose: [f64; 3]) {
        self.until_fresh_with(range_m, pose, |_| ());
    }

    /// The same, with more that is sent each time: a router may drop a message of a loaded
    /// machine.
    fn until_fresh_with(&mut self, range_m: f32, pose: [f64; 3], more: impl Fn(&Self)) {
        until("an observation", || {
            more(self);
            self.mount([0.0; 3]);
            self.sense(range_m, pose);
            self.read() == Reading::Fresh && self.observation.ego.x_world_m == pose[0]
        });
    }

    /// Sends for a while; the robot must not see it.
    fn assert_lost(&mut self, send: impl Fn(&Self)) {
        for _ in 0..30 {
            send(self);
            std::thread::park_timeout(std::time::Duration::from_millis(10));
            assert_eq!(self.read(), Reading::Lost);
        }
    }
}

fn corridor(settings: &mut Settings) {
    settings.robot.path = String::new();
}

#[test]
fn scan_and_odometry_make_an_observation_and_silence_makes_none() {
    let mut stage = Stage::new(corridor);
    assert_eq!(stage.read(), Reading::Lost);
    stage.until_fresh(7.0, [3.0, -2.0, 0.5]);
    let observation = &stage.observation;
    assert_eq!(observation.check(), Ok(()));
    assert!(observation.ranges().iter().all(|range_m| *range_m == 7.0));
    let ego = &observation.ego;
    assert_eq!(
        (ego.y_world_m, ego.speed_mps, ego.yaw_rate_radps),
        (-2.0, 1.5, 0.25)
    );
    assert!((ego.heading_world_rad - 0.5).abs() < 1e-9);
    // Silence; nothing is repeated under a new time.
    until("the sensors are too old", || stage.read() == Reading::Lost);
}

#[test]
fn what_is_old_of_another_type_or_wrong_is_not_used() {
    let mut stage = Stage::new(corridor);
    stage.until_fresh(7.0, [1.0, 0.0, 0.0]);
    until("the sensors are too old", || stage.read() == Reading::Lost);
    let fresh_odometry = |stage: &Stage| {
        let now_ns = Moment::now().epoch_ns;
        put(
            &stage.router,
            "/odom",
            &stage.odometry,
            &odometry(now_ns, [1.0, 0.0, 0.0], 1.0),
        );
    };
    let send = |stage: &Stage, of: &TopicType, cdr: &[u8]| {
        fresh_odometry(stage);
        put(&stage.router, "/scan", of, cdr);
    };
    // An hour old, and an hour in the future.
    for off_s in [-3600_i64, 3600] {
        stage.assert_lost(|stage| {
            let then_ns = Moment::now()
                .epoch_ns
                .saturating_add_signed(off_s * 1_000_000_000);
            send(stage, &stage.scan, &scan(then_ns, "laser", 7.0));
        });
    }
    let other = TopicType {
        hash: standard("nav_msgs/Path").hash,
        ..stage.scan.clone()
    };
    let now = |frame: &str| scan(Moment::now().epoch_ns, frame, 7.0);
    stage.assert_lost(|stage| send(stage, &other, &now("laser")));
    stage.assert_lost(|stage| send(stage, &stage.scan, &now("laser")[..300]));
    stage.assert_lost(|stage| send(stage, &stage.scan, &[]));
    // TF says that the scanner is elsewhere than [scanner] does.
    stage.assert_lost(|stage| {
        stage.mount([0.5, 0.0, 0.0]);
        send(stage, &stage.scan, &now("laser"));
    });
    // All that was refused hides nothing that is right.
    stage.until_fresh(6.0, [2.0, 0.0, 0.0]);
}

/// Along the x axis of the odometry when the map is 4 m beside it.
fn straight() -> Vec<[f64; 2]> {
    (0..=100).map(|k| [f64::from(k), 4.0]).collect()
}

#[test]
fn a_path_makes_the_road_and_its_end_ends_the_episode() {
    let mut stage = Stage::new(|_| ());
    // Without a path the robot stands, although it hears its sensors.
    until("the sensors are heard", || {
        stage.mount([0.0; 3]);
        stage.sense(9.0, [0.25, 0.0, 0.0]);
        assert_eq!(stage.read(), Reading::Lost);
        stage.observation.ego.x_world_m == 0.25
    });
    let send = |stage: &Stage| {
        stage.map([0.0, 4.0, 0.0]);
        stage.path(&straight());
    };
    stage.until_fresh_with(9.0, [10.0, 0.5, 0.0], send);
    let road = stage.observation.road;
    // The path is at y = 0 of the odometry's frame.
    assert!((road.offset_m - 0.5).abs() < 1e-9, "{road:?}");
    let status = stage.robot.status();
    assert!((status.completion - 0.1).abs() < 1e-6, "{status:?}");
    assert_eq!(status.ended, None);
    // A place is looked for near the last one: the car drives there.
    for along_m in [25.0, 40.0, 55.0, 70.0, 85.0, 99.9] {
        stage.until_fresh(9.0, [along_m, 0.0, 0.0]);
    }
    assert_eq!(stage.robot.status().ended, Some(Outcome::Arrived));
    // The same path is not driven again, however often it comes.
    stage.robot.begin(0).expect("the next episode");
    stage.assert_lost(|stage| {
        send(stage);
        stage.mount([0.0; 3]);
        stage.sense(9.0, [99.9, 0.0, 0.0]);
    });
    assert_eq!(stage.robot.status().ended, None);
    // Another one is, and the same one after an empty one.
    let shorter = &straight()[..60];
    stage.until_fresh_with(9.0, [1.0, 0.0, 0.0], |stage| stage.path(shorter));
    until("the path is taken back", || {
        stage.path(&[]);
        stage.mount([0.0; 3]);
        stage.sense(9.0, [2.0, 0.0, 0.0]);
        stage.read() == Reading::Lost && stage.observation.ego.x_world_m == 2.0
    });
    stage.until_fresh_with(9.0, [3.0, 0.0, 0.0], send);
    assert!((stage.robot.status().course_m - 100.0).abs() < 1e-9);
}

#[test]
fn a_path_that_is_repeated_is_followed_on_its_own_branch() {
    let mut stage = Stage::new(|_| ());
    // It crosses itself at 30, 0: there it is 30 m and 210 m long.
    let eight = [
        [0.0, 0.0],
        [60.0, 0.0],
        [60.0, 60.0],
        [30.0, 60.0],
        [30.0, -60.0],
    ];
    let send = |stage: &Stage| {
        stage.map([0.0; 3]);
        stage.path(&eight);
    };
    for x_m in [15.0, 24.0, 28.0, 29.5] {
        stage.until_fresh_with(9.0, [x_m, -0.8, 0.0], send);
    }
    // Several looks at the path long; here the other branch is nearer.
    let mut fresh = 0;
    until("forty readings", || {
        send(&stage);
        stage.mount([0.0; 3]);
        stage.sense(9.0, [29.5, -0.8, 0.0]);
        std::thread::park_timeout(std::time::Duration::from_millis(10));
        fresh += i32::from(stage.read() == Reading::Fresh);
        let status = stage.robot.status();
        let along_m = status.completion * status.course_m;
        assert!((along_m - 29.5).abs() < 1e-6, "{along_m}");
        fresh == 40
    });
}

#[test]
fn odometry_in_another_frame_for_a_moment_does_not_cost_the_path() {
    let mut stage = Stage::new(|_| ());
    let send = |stage: &Stage| {
        stage.map([0.0, 4.0, 0.0]);
        stage.path(&straight());
    };
    stage.until_fresh_with(9.0, [10.0, 0.5, 0.0], send);
    // A path in one frame is not followed by the places of another.
    until("the path is lost", || {
        let now_ns = Moment::now().epoch_ns;
        let elsewhere = odometry_in("elsewhere", now_ns, [11.0, 0.0, 0.0], 1.5);
        put(&stage.router, "/odom", &stage.odometry, &elsewhere);
        put(
            &stage.router,
            "/scan",
            &stage.scan,
            &scan(now_ns, "laser", 9.0),
        );
        let reading = stage.read();
        let is_heard = stage.observation.ego.x_world_m == 11.0;
        assert!(!is_heard || reading == Reading::Lost);
        is_heard
    });
    // Longer than from one look at the path to the next.
    stage.assert_lost(|stage| {
        let now_ns = Moment::now().epoch_ns;
        let elsewhere = odometry_in("elsewhere", now_ns, [11.0, 0.0, 0.0], 1.5);
        put(&stage.router, "/odom", &stage.odometry, &elsewhere);
    });
    stage.until_fresh(9.0, [12.0, 0.5, 0.0]);
}

#[test]
fn a_scanner_that_fails_is_not_a_free_way() {
    let mut stage = Stage::new(corridor);
    stage.until_fresh(9.0, [1.0, 0.0, 0.0]);
    until("the sensors are too old", || stage.read() == Reading::Lost);
    for range_m in [f32::NAN, 0.0] {
        stage.assert_lost(|stage| stage.sense(range_m, [1.0, 0.0, 0.0]));
    }
    stage.until_fresh(9.0, [2.0, 0.0, 0.0]);
}

#[test]
fn the_tick_allocates_nothing() {
    for with_path in [false, true] {
        let mut stage = Stage::new(|settings| {
            if !with_path {
                corridor(settings);
            }
        });
        let send = |stage: &Stage| {
            stage.map([0.0, 4.0, 0.0]);
            stage.path(&straight());
        };
        stage.until_fresh_with(9.0, [0.0; 3], |stage| {
            if with_path {
                send(stage);
            }
        });
        let mut fresh = 0;
        until("twenty ticks", || {
            stage.mount([0.0; 3]);
            stage.sense(9.0, [f64::from(fresh) * 0.1, 0.0, 0.0]);
            std::thread::park_timeout(std::time::Duration::from_millis(5));
            let mut reading = Reading::Lost;
            let action = Action {
                steer: 0.1,
                pedal: 0.2,
            };
            let counted = allocation_counter::measure(|| {
                stage.robot.obey(action, 0.1);
                reading = stage.robot.read(&mut stage.observation);
                let _ = stage.robot.status();
            });
            assert_eq!(counted.count_total, 0, "with a path: {with_path}");
            fresh += i32::from(reading == Reading::Fresh);
            fresh == 20
        });
        // It was really looked for.
        let ahead_m = stage.observation.checkpoints[0].x_body_m;
        assert!(ahead_m > 1.0, "{ahead_m}");
    }
}

/// Angle, its speed, speed, acceleration and jerk of a drive.
fn numbers(cdr: &[u8]) -> Vec<f32> {
    let floats = cdr[cdr.len() - 20..].chunks(4);
    let floats = floats.map(|four| f32::from_le_bytes(four.try_into().expect("four")));
    floats.collect()
}

#[test]
fn a_command_is_an_angle_and_a_speed_and_the_last_one_is_the_brake() {
    let mut stage = Stage::new(corridor);
    let heard = hear(&stage.router, "0/drive/*/*");
    stage.until_fresh(9.0, [0.0; 3]);
    let vehicle = Config::default().vehicle;
    // A robot that moves already, as after a restart of the world, is not asked to stand.
    let coast = Action {
        steer: 0.0,
        pedal: 0.0,
    };
    let mut first = None;
    until("the drive is heard", || {
        stage.robot.obey(coast, 0.1);
        first = heard
            .recv_timeout(std::time::Duration::from_millis(50))
            .ok();
        first.is_some()
    });
    let first = first.expect("a command").payload().to_bytes().into_owned();
    assert_eq!(numbers(&first)[2], 1.5);
    let drive = Action {
        steer: 0.5,
        pedal: 1.0,
    };
    until("the wheels are turned", || {
        stage.robot.obey(drive, 0.1);
        let sample = heard.recv_timeout(std::time::Duration::from_millis(50));
        sample.is_ok_and(|sample| numbers(&sample.payload().to_bytes())[0] > 0.0)
    });
    stage.sense(9.0, [0.0; 3]);
    stage.robot.obey(drive, 0.1);
    let sample = heard.recv_timeout(LOST).expect("a command");
    let [angle_rad, _, speed_mps, accel_mps2, _] = numbers(&sample.payload().to_bytes())[..] else {
        panic!("five numbers");
    };
    assert!((f64::from(angle_rad) - vehicle.max_steer_rad() / 2.0).abs() < 1e-6);
    assert!((f64::from(accel_mps2) - vehicle.max_accel_mps2).abs() < 1e-6);
    assert!(speed_mps > 0.0 && f64::from(speed_mps) < 1.5 + vehicle.max_accel_mps2);
    // As the process does at its end.
    stage.robot.brake(0.0);
    drop(stage.robot);
    let mut last = None;
    while let Ok(sample) = heard.recv_timeout(std::time::Duration::from_millis(500)) {
        last = Some(numbers(&sample.payload().to_bytes()));
    }
    let last = last.expect("the brake");
    assert_eq!((last[0], last[2]), (0.0, 0.0));
}

#[test]
fn lockstep_is_refused() {
    let mut config = Config::default();
    config.run.clock = shm_config::config::Clock::Lockstep;
    let refused = RosRobot::open(&config, &Settings::default()).err();
    assert!(refused.is_some_and(|line| line.contains("--lockstep")));
}
