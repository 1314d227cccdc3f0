//! How a car moves: a chassis on four sprung wheels over flat ground.
//!
//! MetaDrive drives Bullet's *raycast vehicle*, so the response of the car is
//! that algorithm's, in closed form; nothing here is fitted. Each sub-step of
//! 0.02 s, five a tick:
//!
//! 1. gravity, then position and orientation by the velocities of now;
//! 2. each wheel looks for the ground along the chassis' down axis; a spring
//!    (40 per s², per kg of the whole car) and a damper (1.2 in, 4.8 out)
//!    push along the ground's normal;
//! 3. each wheel asks for the sideways impulse that would take away a *fifth*
//!    of its slip (this is the measured yaw lag), and for the impulse of the
//!    engine, or of the brake (never more than would stop the car);
//! 4. when any wheel asks for more than friction gives, that wheel's impulses
//!    shrink to the limit `friction * load`. A forward impulse counts half,
//!    which is why the car may brake at nearly 12 m/s² with a friction of 0.9
//!    but slides above 11 to 12 m/s² sideways. Braking unloads the rear
//!    wheels and cornering the inner ones, hence the third dimension here.
//!
//! What MetaDrive *reads* is the pose of one sub-step before (Bullet's
//! interpolated motion state): [`Motion::seen`] against [`Motion::body`].
//!
//! An ego other than MetaDrive's is driven by its limits alone, as a kinematic bicycle.
//!
//! `./vlaps bench parity` checks it against recorded drives. Sources:
//! `base_vehicle.py` and `vehicle_type.py` of MetaDrive c29cc37, Panda3D's
//! vehicle (rest length 0.4 m, suspension force at most 6000 N).

mod bicycle;
mod group;
mod motion;
mod own;
mod wheels;

pub(crate) use group::{GROUP, Group};
pub use motion::Motion;

use std::sync::LazyLock;

use nalgebra::Vector3;
use vehicle::{Action, Point, Vector, Vehicle};

use crate::model::{Forces, VehicleKind, VehicleModel};
use crate::simd::Width;

/// Length of a physics sub-step, s.
pub const SUBSTEP_S: f64 = 0.02;
/// Sub-steps in one tick of 0.1 s.
pub const SUBSTEPS: u32 = 5;

pub(crate) const GRAVITY_MPS2: f64 = 9.81;
const SUSPENSION_REST_M: f64 = 0.4;
const SUSPENSION_TRAVEL_M: f64 = 0.15;
/// Spring, 1/s²: force per metre and per kilogram of the whole car.
const STIFFNESS: f64 = 40.0;
const DAMPING_IN: f64 = 1.2;
const DAMPING_OUT: f64 = 4.8;
const SUSPENSION_FORCE_MAX_N: f64 = 6000.0;
/// Share of a wheel's side slip taken away in one sub-step.
const SIDE_CORRECTION: f64 = 0.2;
/// How much a forward impulse counts against the friction limit.
const FORWARD_WEIGHT: f64 = 0.5;
/// Height of the point where side impulses act, as a share of its real one.
const ROLL_INFLUENCE: f64 = 0.5;
/// Impulse that resists rolling while the pedal is not braking, N s.
const ROLLING_BRAKE: f64 = 2.0;
/// Below this forward speed the brake pedal only holds, m/s.
const BRAKE_DEADZONE_MPS: f64 = 0.01;
/// Wheels reach for the ground while the chassis' up axis points up by this.
const UPRIGHT: f64 = 0.1;
/// The engine is cut above this, m/s.
const ENGINE_CUT_MPS: f64 = 80.0 / 3.6;

/// One car: its kind, its engine, and what follows from them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Car {
    /// Its measures.
    pub model: &'static VehicleModel,
    /// Its engine and brakes.
    pub forces: Forces,
    derived: &'static Derived,
    /// The limits of a car that moves as a bicycle.
    bicycle: Option<&'static Vehicle>,
}

/// What follows from the measures of a kind of car. All cars of a kind share it, so that
/// a world with many cars is small.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Derived {
    /// Height of the wheels' mounts above the chassis' floor, m.
    mount_m: f64,
    /// Radius of the circle around its rectangle, m.
    radius_m: f64,
    inverse_mass: f64,
    /// About the forward, left and up axes.
    inverse_inertia: Vector3<f64>,
}

/// By the number of the kind.
static DERIVED: LazyLock<[Derived; VehicleKind::ALL.len()]> =
    LazyLock::new(|| VehicleKind::ALL.map(Derived::of));

impl Derived {
    fn of(kind: VehicleKind) -> Derived {
        // `CHASSIS_TO_WHEEL_AXIS`
        let drop_m = match kind {
            VehicleKind::ExtraLarge => 0.3,
            VehicleKind::Default
            | VehicleKind::Small
            | VehicleKind::Medium
            | VehicleKind::Large => 0.2,
        };
        Derived::of_model(kind.model(), drop_m)
    }

    fn of_model(model: &VehicleModel, drop_m: f64) -> Derived {
        let (l, w, h) = (model.length_m, model.width_m, model.height_m);
        // A box of even density, about its floor's centre: what the simulator uses.
        let inertia =
            Vector3::new(w * w + h * h, l * l + h * h, l * l + w * w) * (model.mass_kg / 12.0);
        Derived {
            mount_m: model.wheel_radius_m - drop_m,
            radius_m: l.hypot(w) / 2.0,
            inverse_mass: 1.0 / model.mass_kg,
            inverse_inertia: inertia.map(|moment| 1.0 / moment),
        }
    }
}

/// What the pedals and the wheel ask of the car for one tick; by default
/// straight on, rolling.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Controls {
    steer_sin: f64,
    steer_cos: f64,
    engine_n: f64,
    brake_ns: f64,
    /// Of a bicycle, in place of engine and brake.
    accel_mps2: f64,
}

impl Default for Controls {
    fn default() -> Controls {
        Controls {
            steer_sin: 0.0,
            steer_cos: 1.0,
            engine_n: 0.0,
            brake_ns: ROLLING_BRAKE,
            accel_mps2: 0.0,
        }
    }
}

impl Car {
    /// A car of this kind with this engine.
    pub fn new(kind: VehicleKind, forces: Forces) -> Car {
        Car {
            model: kind.model(),
            forces,
            derived: &DERIVED[kind as usize],
            bicycle: None,
        }
    }

    /// The ego's car. MetaDrive's default car has its springs, tyres and this engine; any
    /// other moves as a bicycle within its limits. The delay is not the car's motion.
    pub fn ego(vehicle: &Vehicle, forces: Forces) -> Car {
        match own::shared(vehicle) {
            None => Car::new(VehicleKind::Default, forces),
            Some(own) => Car {
                model: &own.model,
                forces,
                derived: &own.derived,
                bicycle: Some(&own.vehicle),
            },
        }
    }

    /// Whether it moves as a bicycle, apart from the groups of sprung cars.
    pub(crate) fn is_bicycle(&self) -> bool {
        self.bicycle.is_some()
    }

    /// The same motion one tick (0.1 s) later. A non-finite action brakes.
    pub fn tick(&self, motion: &mut Motion, action: Action) {
        let controls = self.controls(motion, action);
        for _ in 0..SUBSTEPS {
            self.substep(motion, &controls);
        }
    }

    /// What an action asks of this car, held for a tick. A non-finite action brakes.
    pub fn controls(&self, motion: &Motion, action: Action) -> Controls {
        let action = action.clamped();
        let (steer_sin, steer_cos) = (action.steer * self.model.max_steer_deg)
            .to_radians()
            .sin_cos();
        let accel_mps2 = self
            .bicycle
            .map_or(0.0, |vehicle| action.control(vehicle).accel_mps2);
        let (engine_n, brake_ns) = if action.pedal >= 0.0 {
            let cut = motion.speed_mps() > ENGINE_CUT_MPS;
            let engine_n = if cut {
                0.0
            } else {
                self.forces.engine_n * action.pedal
            };
            (engine_n, ROLLING_BRAKE)
        } else if motion.forward_mps() < BRAKE_DEADZONE_MPS {
            (0.0, ROLLING_BRAKE)
        } else {
            (0.0, -action.pedal * self.forces.brake)
        };
        Controls {
            steer_sin,
            steer_cos,
            engine_n,
            brake_ns,
            accel_mps2,
        }
    }

    /// The same motion one sub-step (0.02 s) later.
    pub fn substep(&self, motion: &mut Motion, controls: &Controls) {
        if let Some(vehicle) = self.bicycle {
            bicycle::substep(vehicle, motion, controls);
            return;
        }
        let mut group = Group::default();
        group.push(self, motion, controls);
        group.substep(Width::SCALAR);
        *motion = group.motion(0);
    }

    /// Radius of the circle around the car's rectangle, m.
    pub fn radius_m(&self) -> f64 {
        self.derived.radius_m
    }

    /// A horizontal impulse (N s, world frame) at a point of the ground plane,
    /// as a collision gives it.
    pub fn shove(&self, motion: &mut Motion, impulse_world: Vector, at_world: Point) {
        let from_center = at_world.coords - motion.position.xy();
        motion.velocity.x += impulse_world.x * self.derived.inverse_mass;
        motion.velocity.y += impulse_world.y * self.derived.inverse_mass;
        motion.spin.z += from_center.perp(&impulse_world) * self.derived.inverse_inertia.z;
    }

    /// Velocity that a unit impulse at a point of the ground plane gives that
    /// point along itself, 1/kg.
    pub fn planar_mobility(
        &self,
        motion: &Motion,
        at_world: Point,
        direction_world: Vector,
    ) -> f64 {
        let lever_m = (at_world.coords - motion.position.xy()).perp(&direction_world);
        self.derived.inverse_mass + lever_m * lever_m * self.derived.inverse_inertia.z
    }
}
