//! The picture of a question: where the paths lie, and what a swap changes.

use gate::presentation::picture::{Encoding, Photo, PictureError, Proposals, Style, draw, picture};
use gate::presentation::{Hue, Party, Showing};
use shm_config::config::Rollout;
use shm_config::message::{Camera, View};
use shm_config::palette;
use vehicle::{Action, Vehicle};

const SIZE: [u32; 2] = [480, 480];

/// A road without objects that fills the whole picture.
fn asphalt() -> Vec<u8> {
    palette::ROAD.repeat((SIZE[0] * SIZE[1]) as usize)
}

fn photo<'a>(camera: &'a Camera, rgb: &'a [u8]) -> Photo<'a> {
    let [width, height] = SIZE;
    Photo {
        camera,
        width,
        height,
        rgb,
    }
}

fn action(steer: f64, pedal: f64) -> Action {
    Action { steer, pedal }
}

fn proposals(vehicle: &Vehicle, expert: Action, policy: Action) -> Proposals<'_> {
    Proposals {
        vehicle,
        speed_mps: 8.0,
        expert,
        policy,
    }
}

fn bare() -> Style {
    Style {
        footprint: false,
        legend: false,
        ..Style::default()
    }
}

const SHOWING: Showing = Showing {
    first: Party::Policy,
    hues: [Hue::Magenta, Hue::Cyan],
};

#[test]
fn paths_lie_where_the_bicycle_goes() {
    // 480 px show 60 m: 8 px/m, the car at (240, 360). Straight on at 8 m/s for 3 s is
    // 24 m: 192 px up. The other path is a full brake: 8 m/s are gone after 8 / 11.8 =
    // 0.68 s; the seven steps of 0.1 s until then cover 0.1 * (7 * 8 - 1.18 * 21) =
    // 3.122 m: 25 px.
    let vehicle = Vehicle::default();
    let camera = Camera::top_down(SIZE);
    let (straight, brake) = (action(0.0, 0.0), action(0.0, -1.0));
    let both = proposals(&vehicle, straight, brake);
    let rgb = asphalt();
    let image = draw(photo(&camera, &rgb), &both, SHOWING, &bare()).expect("a picture");
    // Side by side: equal wheels, so the first is on the left. Lines of 5 px with their
    // rims: their middles are 3.3 px aside where both paths are, and 0 px beyond.
    let at = |x: u32, y: u32| image.get_pixel(x, y).0;
    let (first, second) = (Hue::Magenta.rgb(), Hue::Cyan.rgb());
    assert_eq!(at(236, 350), first, "the brake, on the left");
    assert_eq!(at(243, 350), second, "straight on, beside it");
    assert_eq!(at(240, 250), second, "straight on alone");
    assert_eq!(at(240, 170), second, "almost 24 m ahead");
    assert_ne!(at(240, 162), second, "beyond 24 m");
    // The brake's label stands left of its end; below it the path has ended.
    assert_ne!(at(236, 330), first, "beyond 3.1 m");
}

#[test]
fn a_turn_ends_where_the_circle_says() {
    let vehicle = Vehicle::default();
    let camera = Camera::top_down(SIZE);
    let both = proposals(&vehicle, action(0.2, 0.0), action(-0.2, 0.0));
    let rgb = asphalt();
    let image = draw(photo(&camera, &rgb), &both, Showing::PAPER, &bare()).expect("a picture");
    let radius_m = vehicle.wheelbase_m / (0.2 * vehicle.max_steer_rad()).tan();
    let turned_rad: f64 = 24.0 / radius_m;
    let (x_m, y_m) = (
        radius_m * turned_rad.sin(),
        radius_m * (1.0 - turned_rad.cos()),
    );
    let near = |rgb: [u8; 3], left_m: f64| {
        let (u, v) = (240.0 - 8.0 * left_m, 360.0 - 8.0 * x_m);
        image
            .enumerate_pixels()
            .any(|(x, y, pixel)| pixel.0 == rgb && (f64::from(x) - u).hypot(f64::from(y) - v) < 6.0)
    };
    assert!(near(Hue::Red.rgb(), y_m), "the expert to the left");
    assert!(near(Hue::Blue.rgb(), -y_m), "the policy to the right");
    assert!(!near(Hue::Blue.rgb(), y_m));
}

#[test]
fn a_swap_changes_colours_and_letters_alone() {
    let vehicle = Vehicle::default();
    for view in [View::TopDown, View::Ego] {
        let camera = Camera::of(view, SIZE);
        let both = proposals(&vehicle, action(0.1, 0.5), action(-0.05, -0.2));
        let rgb = asphalt();
        let drawn = |showing| {
            draw(photo(&camera, &rgb), &both, showing, &Style::default()).expect("a picture")
        };
        let (image, swapped) = (drawn(SHOWING), drawn(SHOWING.swapped()));
        let hues = SHOWING.hues.map(Hue::rgb);
        let (mut turned, mut different) = (0, 0);
        for (pixel, other) in image.pixels().zip(swapped.pixels()) {
            match hues.iter().position(|hue| *hue == pixel.0) {
                Some(index) if other.0 == hues[1 - index] => turned += 1,
                _ => different += usize::from(pixel != other),
            }
        }
        assert!(turned > 500, "{view:?}: the paths' pixels change colour");
        // The other differences are blended rims and two letters; the legend does not
        // differ.
        assert!(different < turned, "{view:?}: {different} of {turned}");
    }
}

#[test]
fn swapping_twice_or_drawing_twice_gives_the_same_bytes() {
    let vehicle = Vehicle::default();
    let camera = Camera::top_down(SIZE);
    let both = proposals(&vehicle, action(0.1, 0.5), action(-0.05, -0.2));
    let rgb = asphalt();
    for encoding in [Encoding::Png, Encoding::Jpeg] {
        let style = Style {
            encoding,
            ..Style::default()
        };
        let bytes = |showing: Showing| {
            let drawn = picture(photo(&camera, &rgb), &both, showing, &style);
            drawn.expect("a picture").bytes
        };
        let one = bytes(SHOWING);
        assert_eq!(one, bytes(SHOWING.swapped().swapped()));
        assert_ne!(one, bytes(SHOWING.swapped()));
        let decoded = image::load_from_memory(&one).expect("decodes");
        assert_eq!((decoded.width(), decoded.height()), (480, 480));
    }
}

#[test]
fn equal_proposals_are_both_visible() {
    let vehicle = Vehicle::default();
    for view in [View::TopDown, View::Ego] {
        let camera = Camera::of(view, SIZE);
        let same = action(0.05, 0.3);
        let both = proposals(&vehicle, same, same);
        let rgb = asphalt();
        let image = draw(photo(&camera, &rgb), &both, SHOWING, &bare()).expect("a picture");
        for hue in SHOWING.hues {
            let count = image.pixels().filter(|pixel| pixel.0 == hue.rgb()).count();
            assert!(count > 500, "{view:?} {hue:?}: {count} pixels");
        }
    }
}

#[test]
fn a_car_that_stands_still_has_two_letters() {
    let vehicle = Vehicle::default();
    for view in [View::TopDown, View::Ego] {
        let camera = Camera::of(view, SIZE);
        let both = Proposals {
            speed_mps: 0.0,
            ..proposals(&vehicle, action(0.3, -1.0), action(-0.3, -1.0))
        };
        let rgb = asphalt();
        let image = draw(photo(&camera, &rgb), &both, SHOWING, &bare()).expect("a picture");
        for hue in SHOWING.hues {
            let count = image.pixels().filter(|pixel| pixel.0 == hue.rgb()).count();
            assert!(count > 100, "{view:?} {hue:?}: {count} pixels");
        }
    }
}

#[test]
fn the_scaled_picture_has_the_paths_in_their_own_colours() {
    let vehicle = Vehicle::default();
    let camera = Camera::top_down(SIZE);
    let both = proposals(&vehicle, action(0.0, 0.0), action(0.2, 0.0));
    let style = Style {
        size_px: Some([240, 120]),
        ..bare()
    };
    let rgb = asphalt();
    let image = draw(photo(&camera, &rgb), &both, Showing::PAPER, &style).expect("a picture");
    assert_eq!(image.dimensions(), (240, 120));
    // 20 m ahead: 160 px up of 480 are 40 of 120, the middle 120 of 240.
    let on_path = (118..=122).any(|x| image.get_pixel(x, 90 - 40).0 == Hue::Red.rgb());
    assert!(on_path, "straight on, in the middle");
}

#[test]
fn the_papers_step_is_straight_for_any_steering() {
    let vehicle = Vehicle::default();
    let camera = Camera::top_down(SIZE);
    let both = proposals(&vehicle, action(1.0, 0.0), action(-1.0, 0.0));
    let style = Style {
        rollout: Rollout::Paper,
        horizon_s: 1.5,
        ..bare()
    };
    let rgb = asphalt();
    let image = draw(photo(&camera, &rgb), &both, Showing::PAPER, &style).expect("a picture");
    let seen = |hue: Hue| {
        image
            .enumerate_pixels()
            .filter(move |(_, _, p)| p.0 == hue.rgb())
    };
    // 12 m ahead, the two paths side by side, at most a line's width apart.
    for hue in [Hue::Red, Hue::Blue] {
        // Letters stand beyond the end, beside the car's outline.
        let line = || seen(hue).filter(|(_, y, _)| (270..360).contains(y));
        assert!(line().count() > 300, "{hue:?}");
        assert!(line().all(|(x, _, _)| (230..250).contains(&x)), "{hue:?}");
    }
}

#[test]
fn an_incomplete_frame_is_refused() {
    let vehicle = Vehicle::default();
    let camera = Camera::top_down(SIZE);
    let both = proposals(&vehicle, action(0.0, 0.0), action(0.2, 0.0));
    let rgb = asphalt();
    let sized = |width, height| Photo {
        width,
        height,
        ..photo(&camera, &rgb)
    };
    for (width, height) in [(0, 480), (480, 0), (481, 480), (u32::MAX, u32::MAX)] {
        let refused = picture(sized(width, height), &both, SHOWING, &bare());
        assert_eq!(refused, Err(PictureError::Misfit { width, height }));
    }
    let style = Style {
        size_px: Some([10, 480]),
        ..bare()
    };
    let refused = picture(photo(&camera, &rgb), &both, SHOWING, &style);
    let (width, height) = (10, 480);
    assert_eq!(refused, Err(PictureError::Size { width, height }));
}
