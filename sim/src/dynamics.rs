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
//! `./vlaps bench parity` checks it against recorded drives. Sources:
//! `base_vehicle.py` and `vehicle_type.py` of MetaDrive c29cc37, Panda3D's
//! vehicle (rest length 0.4 m, suspension force at most 6000 N).

mod motion;

pub use motion::Motion;

use nalgebra::Vector3;
use vehicle::{Action, Point, Vector};

use crate::model::{Forces, VehicleKind, VehicleModel};

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
    /// Height of the wheels' mounts above the chassis' floor, m.
    mount_m: f64,
    /// Where they are forward and left: front left, front right, rear left,
    /// rear right.
    mounts_m: [(f64, f64); 4],
    inverse_mass: f64,
    /// About the forward, left and up axes.
    inverse_inertia: Vector3<f64>,
}

/// What the pedals and the wheel ask of the car for one tick; by default
/// straight on, rolling.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Controls {
    steer_sin: f64,
    steer_cos: f64,
    engine_n: f64,
    brake_ns: f64,
}

impl Default for Controls {
    fn default() -> Controls {
        Controls {
            steer_sin: 0.0,
            steer_cos: 1.0,
            engine_n: 0.0,
            brake_ns: ROLLING_BRAKE,
        }
    }
}

impl Car {
    /// A car of this kind with this engine.
    pub fn new(kind: VehicleKind, forces: Forces) -> Car {
        let model = kind.model();
        let (l, w, h) = (model.length_m, model.width_m, model.height_m);
        // `CHASSIS_TO_WHEEL_AXIS`
        let drop_m = match kind {
            VehicleKind::ExtraLarge => 0.3,
            VehicleKind::Default
            | VehicleKind::Small
            | VehicleKind::Medium
            | VehicleKind::Large => 0.2,
        };
        // A box of even density, about its floor's centre: what the simulator uses.
        let inertia =
            Vector3::new(w * w + h * h, l * l + h * h, l * l + w * w) * (model.mass_kg / 12.0);
        Car {
            model,
            forces,
            mount_m: model.wheel_radius_m - drop_m,
            mounts_m: [
                (model.front_axle_m, model.half_track_m),
                (model.front_axle_m, -model.half_track_m),
                (-model.rear_axle_m, model.half_track_m),
                (-model.rear_axle_m, -model.half_track_m),
            ],
            inverse_mass: 1.0 / model.mass_kg,
            inverse_inertia: inertia.map(|moment| 1.0 / moment),
        }
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
        }
    }

    /// The same motion one sub-step (0.02 s) later.
    pub fn substep(&self, motion: &mut Motion, controls: &Controls) {
        motion.integrate();
        let mut chassis = Moving {
            velocity: motion.axes.tr_mul(&motion.velocity),
            spin: motion.axes.tr_mul(&motion.spin),
        };
        let up = motion.axes.row(2).transpose();
        // On its side or roof no wheel finds the ground.
        if up.z > UPRIGHT {
            let wheels = self.suspend(motion.position.z, &up, &mut chassis);
            self.roll(&wheels, &up, controls, &mut chassis);
        }
        motion.velocity = motion.axes * chassis.velocity;
        motion.spin = motion.axes * chassis.spin;
    }

    /// Springs and dampers; where each wheel touches and how it is loaded.
    fn suspend(&self, floor_m: f64, up: &Vector3<f64>, moving: &mut Moving) -> [Wheel; 4] {
        let model = self.model;
        let reach_m = SUSPENSION_REST_M + model.wheel_radius_m;
        let slope = 1.0 / up.z;
        let rise_mps = up.dot(&moving.velocity);
        let (mut push_ns, mut twist) = (0.0, Vector3::zeros());
        let mut wheels = [Wheel::default(); 4];
        for (wheel, (x_m, y_m)) in wheels.iter_mut().zip(self.mounts_m) {
            let drop_m = (floor_m + up.x * x_m + up.y * y_m + up.z * self.mount_m) * slope;
            if drop_m > reach_m {
                continue;
            }
            let contact = Vector3::new(x_m, y_m, self.mount_m - drop_m);
            let lever = contact.cross(up);
            let compression_m = (reach_m - drop_m).min(SUSPENSION_TRAVEL_M);
            let rise_mps = (rise_mps + lever.dot(&moving.spin)) * slope;
            let damping = if rise_mps < 0.0 {
                DAMPING_IN
            } else {
                DAMPING_OUT
            };
            let force_n =
                (STIFFNESS * compression_m * slope - damping * rise_mps).max(0.0) * model.mass_kg;
            *wheel = Wheel {
                contact,
                load_ns: force_n * SUBSTEP_S,
                touches: true,
            };
            let impulse_ns = force_n.min(SUSPENSION_FORCE_MAX_N) * SUBSTEP_S;
            push_ns += impulse_ns;
            twist += lever * impulse_ns;
        }
        self.push(moving, &(up * push_ns), &twist);
        wheels
    }

    /// Tyres: engine, brake and side slip, limited by friction. All wheels
    /// decide by the same velocities, then all act.
    fn roll(
        &self,
        wheels: &[Wheel; 4],
        up: &Vector3<f64>,
        controls: &Controls,
        moving: &mut Moving,
    ) {
        let (mut push, mut twist) = (Vector3::zeros(), Vector3::zeros());
        let steered = Vector3::new(controls.steer_sin, -controls.steer_cos, 0.0);
        let fixed = Vector3::new(0.0, -1.0, 0.0);
        for (axle, right) in wheels.chunks_exact(2).zip([steered, fixed]) {
            let right = (right - up * up.dot(&right)).normalize();
            let forward = up.cross(&right);
            for wheel in axle.iter().filter(|wheel| wheel.touches) {
                let ahead = Lever::new(&wheel.contact, forward);
                let aside = Lever::new(&wheel.contact, right);
                let side_ns = -SIDE_CORRECTION * aside.slip_mps(moving) / self.mobility(&aside.arm);
                let forward_ns = if controls.engine_n != 0.0 {
                    controls.engine_n * SUBSTEP_S
                } else {
                    // Each wheel would stop the whole car alone, so together
                    // they overshoot: a car comes to rest rocking.
                    let stop_ns = -ahead.slip_mps(moving) / self.mobility(&ahead.arm);
                    stop_ns.clamp(-controls.brake_ns, controls.brake_ns)
                };
                let limit_ns = wheel.load_ns * self.model.wheel_friction;
                let asked = (forward_ns * FORWARD_WEIGHT).powi(2) + side_ns * side_ns;
                let share = if asked > limit_ns * limit_ns {
                    limit_ns / asked.sqrt()
                } else {
                    1.0
                };
                let (forward_ns, side_ns) = (forward_ns * share, side_ns * share);
                push += ahead.along * forward_ns + aside.along * side_ns;
                // The side impulse acts higher up than the ground.
                let raise_m = wheel.contact.z * (1.0 - ROLL_INFLUENCE);
                let raised = aside.arm - Vector3::new(-right.y, right.x, 0.0) * raise_m;
                twist += ahead.arm * forward_ns + raised * side_ns;
            }
        }
        self.push(moving, &push, &twist);
    }

    /// Velocity that a unit impulse on a lever gives its end along itself.
    fn mobility(&self, arm: &Vector3<f64>) -> f64 {
        self.inverse_mass + arm.component_mul(&self.inverse_inertia).dot(arm)
    }

    fn push(&self, moving: &mut Moving, impulse: &Vector3<f64>, twist: &Vector3<f64>) {
        moving.velocity += impulse * self.inverse_mass;
        moving.spin += twist.component_mul(&self.inverse_inertia);
    }

    /// A horizontal impulse (N s, world frame) at a point of the ground plane,
    /// as a collision gives it.
    pub fn shove(&self, motion: &mut Motion, impulse_world: Vector, at_world: Point) {
        let from_center = at_world.coords - motion.position.xy();
        motion.velocity.x += impulse_world.x * self.inverse_mass;
        motion.velocity.y += impulse_world.y * self.inverse_mass;
        motion.spin.z += from_center.perp(&impulse_world) * self.inverse_inertia.z;
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
        self.inverse_mass + lever_m * lever_m * self.inverse_inertia.z
    }
}

/// Velocities in the chassis' own axes.
#[derive(Clone, Copy)]
struct Moving {
    velocity: Vector3<f64>,
    spin: Vector3<f64>,
}

/// A direction at a point of the chassis.
struct Lever {
    along: Vector3<f64>,
    /// The point's offset from the centre, crossed with the direction.
    arm: Vector3<f64>,
}

impl Lever {
    fn new(at: &Vector3<f64>, along: Vector3<f64>) -> Lever {
        Lever {
            along,
            arm: at.cross(&along),
        }
    }

    /// Velocity of the point along the direction.
    fn slip_mps(&self, moving: &Moving) -> f64 {
        self.along.dot(&moving.velocity) + self.arm.dot(&moving.spin)
    }
}

/// One wheel on the ground, or above it.
#[derive(Clone, Copy, Default)]
struct Wheel {
    /// Where it touches the ground, in the chassis' axes, m.
    contact: Vector3<f64>,
    /// Impulse that carries the car, N s.
    load_ns: f64,
    touches: bool,
}
