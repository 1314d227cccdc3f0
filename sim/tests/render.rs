//! Pictures show the bodies and the road where the camera projects them.

use shm_config::message::{Camera, View};
use shm_config::palette::{self, Rgb};
use sim::idm::Idm;
use sim::lane::Lane;
use sim::render::{Picture, Renderer, Shot};
use sim::world::BodyKind;
use sim::{World, WorldConfig};
use vehicle::{Point, Vector};

const SEEDS: [u64; 4] = [3, 1000, 1007, 1021];
/// Number of ticks between pictures.
const TICKS: [u64; 4] = [0, 60, 120, 180];
/// Points nearer than this to a border are not compared, m, because lines are painted
/// there.
const BORDER_M: f64 = 0.5;

/// Calls `look` with worlds during episodes in dense traffic.
fn look_at_scenes(mut look: impl FnMut(&World, &mut Renderer)) {
    let config = WorldConfig {
        traffic_density: 0.4,
        ..WorldConfig::default()
    };
    let mut world = World::new(config).expect("a world");
    let mut renderer = Renderer::default();
    for seed in SEEDS {
        world.reset(seed).expect("a map");
        renderer.begin(&world);
        let mut idm = Idm::new(0, seed);
        for tick in 0..=TICKS[TICKS.len() - 1] {
            if TICKS.contains(&tick) {
                look(&world, &mut renderer);
            }
            let action = world.advise(&mut idm);
            world.step(action);
        }
    }
}

fn shot(view: View) -> Shot {
    Shot {
        view,
        size_px: [640, 480],
        passed: 0.0,
    }
}

fn pixel(picture: &Picture, [u, v]: [f64; 2]) -> Option<Rgb> {
    let [width, height] = picture.size_px.map(f64::from);
    if !(0.0..width).contains(&u) || !(0.0..height).contains(&v) {
        return None;
    }
    let at = (v as usize * picture.size_px[0] as usize + u as usize) * 3;
    picture.rgb[at..at + 3].try_into().ok()
}

/// A point on the ground: its position in the world and the pixel's colour.
fn seen(world: &World, picture: &Picture, [x_m, y_m, z_m]: [f64; 3]) -> Option<(Point, Rgb)> {
    let [u, v] = picture.camera.project([x_m, y_m, z_m])?;
    let point = world.world_from_ego() * Point::new(x_m, y_m);
    Some((point, pixel(picture, [u, v])?))
}

fn within(lane: &Lane, point: Point, margin_m: f64) -> bool {
    let (along_m, across_m) = lane.local_coordinates(point);
    (-margin_m..=lane.length_m + margin_m).contains(&along_m)
        && across_m.abs() <= lane.width_m / 2.0 + margin_m
}

fn check_ground(view: View, reach_m: i32) {
    let (mut roads, mut outside) = (0, 0);
    look_at_scenes(|world, renderer| {
        let picture = renderer.draw(world, &shot(view)).expect("a picture");
        let lanes = world.map().network.lanes();
        for (x, y) in (-14..reach_m).flat_map(|x| (-reach_m..reach_m).map(move |y| (x, y))) {
            let at = [f64::from(x) + 0.3, f64::from(y) * 0.7, 0.0];
            let Some((point, color)) = seen(world, &picture, at) else {
                continue;
            };
            let what = format!(
                "{view}, seed {}, tick {}, {at:?}",
                world.seed(),
                world.ticks()
            );
            if lanes.iter().any(|lane| within(lane, point, -BORDER_M)) {
                roads += 1;
                let off = [palette::GROUND, palette::SIDEWALK, palette::SKY];
                assert!(!off.contains(&color), "{what} is road, not {color:?}");
            } else if !lanes.iter().any(|lane| within(lane, point, BORDER_M)) {
                outside += 1;
                let on = [palette::ROAD, palette::LINE_SOLID, palette::LINE_BROKEN];
                assert!(!on.contains(&color), "{what} is no road, but {color:?}");
            }
        }
    });
    assert!(
        roads > 500 && outside > 500,
        "{roads} on the road, {outside} beside"
    );
}

#[test]
fn road_is_road_and_ground_is_ground_from_above() {
    check_ground(View::TopDown, 30);
}

#[test]
fn road_is_road_and_ground_is_ground_from_the_seat() {
    check_ground(View::Ego, 16);
}

#[test]
fn every_car_is_seen_where_it_is() {
    let mut cars = [0; 2];
    look_at_scenes(|world, renderer| {
        for (view, cars) in [View::TopDown, View::Ego].into_iter().zip(&mut cars) {
            let picture = renderer.draw(world, &shot(view)).expect("a picture");
            for body in world.bodies() {
                let BodyKind::Traffic(kind) = body.kind else {
                    continue;
                };
                let at = world.world_from_ego().inverse() * body.placed.center_world;
                if at.coords.norm() > 40.0 {
                    continue;
                }
                let middle = [at.x, at.y, kind.model().height_m * 0.4];
                let Some((_, color)) = seen(world, &picture, middle) else {
                    continue;
                };
                *cars += 1;
                let empty = [
                    palette::ROAD,
                    palette::GROUND,
                    palette::SKY,
                    palette::SIDEWALK,
                ];
                let what = format!("{view}, seed {}, tick {}", world.seed(), world.ticks());
                assert!(
                    !empty.contains(&color),
                    "{what}: {kind:?} at {middle:?} is {color:?}"
                );
                if view == View::TopDown {
                    assert_eq!(color, palette::VEHICLE, "{what}: its roof, {middle:?}");
                }
            }
        }
    });
    assert!(cars[0] > 20 && cars[1] > 5, "{cars:?}");
}

#[test]
fn the_car_itself_is_seen_from_above_alone() {
    look_at_scenes(|world, renderer| {
        let picture = renderer
            .draw(world, &shot(View::TopDown))
            .expect("a picture");
        assert_eq!(pixel(&picture, [320.0, 360.0]), Some(palette::EGO));
        let car = picture
            .rgb
            .chunks_exact(3)
            .filter(|pixel| *pixel == palette::EGO);
        let car_px = car.count();
        let picture = renderer.draw(world, &shot(View::Ego)).expect("a picture");
        assert!(car_px > 100);
        assert!(
            !picture
                .rgb
                .chunks_exact(3)
                .any(|pixel| pixel == palette::EGO)
        );
    });
}

#[test]
fn a_picture_is_the_same_each_time_and_carries_its_camera() {
    look_at_scenes(|world, renderer| {
        for view in [View::TopDown, View::Ego] {
            let first = renderer.draw(world, &shot(view)).expect("a picture");
            let (camera, rgb) = (first.camera, first.rgb.to_vec());
            assert_eq!(camera.check(), Ok(()));
            assert_eq!(camera.view, view.code());
            assert_eq!(rgb.len(), 640 * 480 * 3);
            let mut fresh = Renderer::default();
            fresh.begin(world);
            let small = Shot {
                size_px: [64, 64],
                ..shot(view)
            };
            assert!(fresh.draw(world, &small).is_some());
            let again = fresh.draw(world, &shot(view)).expect("a picture");
            assert_eq!(again.camera, camera);
            assert!(again.rgb == rgb, "{view}, seed {}", world.seed());
        }
    });
    let nothing = Shot {
        size_px: [0, 64],
        ..shot(View::Ego)
    };
    let world = World::new(WorldConfig::default()).expect("a world");
    assert!(Renderer::default().draw(&world, &nothing).is_none());
}

#[test]
fn the_horizon_is_level_and_above_the_middle() {
    let camera = Camera::of(View::Ego, [640, 480]);
    let far = |heading_rad: f64| {
        let away = Vector::new(heading_rad.cos(), heading_rad.sin()) * 1e7;
        camera.project([away.x, away.y, 0.0]).expect("ahead")[1]
    };
    assert!((far(0.3) - far(-0.2)).abs() < 1e-3);
    assert!((60.0..240.0).contains(&far(0.0)), "{}", far(0.0));
}
