//! What the four wheels do to the chassis: springs, dampers and tyres, of several cars
//! at once.

use pulp::Simd;

use super::group::{
    BRAKE, Columns, ENGINE, FRICTION, FRONT, HALF_TRACK, INVERSE_INERTIA, INVERSE_MASS, MASS,
    MOUNT, REAR, STEER_COS, STEER_SIN, WHEEL_RADIUS,
};
use super::{
    DAMPING_IN, DAMPING_OUT, FORWARD_WEIGHT, ROLL_INFLUENCE, SIDE_CORRECTION, STIFFNESS, SUBSTEP_S,
    SUSPENSION_FORCE_MAX_N, SUSPENSION_REST_M, SUSPENSION_TRAVEL_M,
};
use crate::simd::{Lanes, Lanes3};

/// Velocities in the chassis' own axes.
#[derive(Clone, Copy)]
pub(super) struct Moving<S: Simd> {
    pub velocity: Lanes3<S>,
    pub spin: Lanes3<S>,
}

impl<S: Simd> Moving<S> {
    /// Adds the effect of an impulse and of its moment.
    #[inline(always)]
    fn push(&mut self, cars: &Columns<S>, impulse: Lanes3<S>, twist: Lanes3<S>) {
        self.velocity = self.velocity + impulse * cars.get(INVERSE_MASS);
        self.spin = self.spin + twist.times(cars.vector(INVERSE_INERTIA));
    }
}

/// A wheel on the ground, or above it.
#[derive(Clone, Copy)]
pub(super) struct Wheel<S: Simd> {
    /// Where it touches the ground, in the chassis' axes, m.
    contact: Lanes3<S>,
    /// Impulse that carries the car, N s.
    load_ns: Lanes<S>,
    /// Where it is above the ground.
    hangs: S::m64s,
}

/// Springs and dampers; where each wheel touches and how it is loaded: front left,
/// front right, rear left, rear right.
#[inline(always)]
pub(super) fn suspend<S: Simd>(
    cars: &Columns<S>,
    floor_m: Lanes<S>,
    up: Lanes3<S>,
    moving: &mut Moving<S>,
) -> [Wheel<S>; 4] {
    let (mount_m, half_track_m) = (cars.get(MOUNT), cars.get(HALF_TRACK));
    let (front_m, rear_m) = (cars.get(FRONT), cars.get(REAR));
    let reach_m = SUSPENSION_REST_M + cars.get(WHEEL_RADIUS);
    let slope = 1.0 / up.z;
    let rise_mps = up.dot(moving.velocity);
    let (mut push_ns, mut twist) = (Lanes::of(cars.simd, 0.0), Lanes3::zero(cars.simd));
    let mounts_m = [
        (front_m, half_track_m),
        (front_m, -half_track_m),
        (rear_m, half_track_m),
        (rear_m, -half_track_m),
    ];
    let zero = Lanes::of(cars.simd, 0.0);
    let mut wheels = [Wheel {
        contact: Lanes3::zero(cars.simd),
        load_ns: zero,
        hangs: zero.is(0.0),
    }; 4];
    for (wheel, (x_m, y_m)) in wheels.iter_mut().zip(mounts_m) {
        let drop_m = (floor_m + up.x * x_m + up.y * y_m + up.z * mount_m) * slope;
        let hangs = reach_m.is_below(drop_m);
        let contact = Lanes3 {
            x: x_m,
            y: y_m,
            z: mount_m - drop_m,
        };
        let lever = contact.cross(up);
        let compression_m = (reach_m - drop_m).at_most(SUSPENSION_TRAVEL_M);
        let rise_mps = (rise_mps + lever.dot(moving.spin)) * slope;
        let (inward, outward) = (
            Lanes::of(cars.simd, DAMPING_IN),
            Lanes::of(cars.simd, DAMPING_OUT),
        );
        let damping = inward.where_or(rise_mps.is_below(zero), outward);
        let force_n =
            (STIFFNESS * compression_m * slope - damping * rise_mps).at_least(0.0) * cars.get(MASS);
        let impulse_ns = force_n.at_most(SUSPENSION_FORCE_MAX_N) * SUBSTEP_S;
        push_ns = push_ns.where_or(hangs, push_ns + impulse_ns);
        twist = twist.where_or(hangs, twist + lever * impulse_ns);
        *wheel = Wheel {
            contact,
            load_ns: force_n * SUBSTEP_S,
            hangs,
        };
    }
    moving.push(cars, up * push_ns, twist);
    wheels
}

/// A direction at a point of the chassis.
#[derive(Clone, Copy)]
struct Lever<S: Simd> {
    along: Lanes3<S>,
    /// The point's offset from the centre, crossed with the direction.
    arm: Lanes3<S>,
}

impl<S: Simd> Lever<S> {
    #[inline(always)]
    fn new(at: Lanes3<S>, along: Lanes3<S>) -> Self {
        Lever {
            along,
            arm: at.cross(along),
        }
    }

    /// Velocity of the point along the direction.
    #[inline(always)]
    fn slip_mps(&self, moving: &Moving<S>) -> Lanes<S> {
        self.along.dot(moving.velocity) + self.arm.dot(moving.spin)
    }

    /// Velocity that a unit impulse along the direction gives the point along itself.
    #[inline(always)]
    fn mobility(&self, cars: &Columns<S>) -> Lanes<S> {
        let inertia = cars.vector(INVERSE_INERTIA);
        cars.get(INVERSE_MASS) + self.arm.times(inertia).dot(self.arm)
    }
}

/// Tyres: engine, brake and side slip, limited by friction. All wheels
/// decide by the same velocities, then all act.
#[inline(always)]
pub(super) fn roll<S: Simd>(
    cars: &Columns<S>,
    wheels: &[Wheel<S>; 4],
    up: Lanes3<S>,
    moving: &mut Moving<S>,
) {
    let simd = cars.simd;
    let (mut push, mut twist) = (Lanes3::zero(simd), Lanes3::zero(simd));
    let (engine_n, brake_ns) = (cars.get(ENGINE), cars.get(BRAKE));
    let coasts = engine_n.is(0.0);
    let zero = Lanes::of(simd, 0.0);
    let steered = Lanes3 {
        x: cars.get(STEER_SIN),
        y: -cars.get(STEER_COS),
        z: zero,
    };
    let fixed = Lanes3 {
        x: zero,
        y: Lanes::of(simd, -1.0),
        z: zero,
    };
    let [front_left, front_right, rear_left, rear_right] = wheels;
    for (axle, right) in [
        ([front_left, front_right], steered),
        ([rear_left, rear_right], fixed),
    ] {
        let right = (right - up * up.dot(right)).normalize();
        let forward = up.cross(right);
        for wheel in axle {
            let ahead = Lever::new(wheel.contact, forward);
            let aside = Lever::new(wheel.contact, right);
            let side_ns = -SIDE_CORRECTION * aside.slip_mps(moving) / aside.mobility(cars);
            // Each wheel would stop the whole car alone, so together
            // they overshoot: a car comes to rest rocking.
            let stop_ns = -ahead.slip_mps(moving) / ahead.mobility(cars);
            let forward_ns = stop_ns
                .within(brake_ns)
                .where_or(coasts, engine_n * SUBSTEP_S);
            let limit_ns = wheel.load_ns * cars.get(FRICTION);
            let weighed_ns = forward_ns * FORWARD_WEIGHT;
            let asked = weighed_ns * weighed_ns + side_ns * side_ns;
            let slides = (limit_ns * limit_ns).is_below(asked);
            let share = (limit_ns / asked.sqrt()).where_or(slides, Lanes::of(simd, 1.0));
            let (forward_ns, side_ns) = (forward_ns * share, side_ns * share);
            let pushed = push + (ahead.along * forward_ns + aside.along * side_ns);
            // The side impulse acts higher up than the ground.
            let raise_m = wheel.contact.z * (1.0 - ROLL_INFLUENCE);
            let outward = Lanes3 {
                x: -right.y,
                y: right.x,
                z: zero,
            };
            let raised = aside.arm - outward * raise_m;
            let twisted = twist + (ahead.arm * forward_ns + raised * side_ns);
            push = push.where_or(wheel.hangs, pushed);
            twist = twist.where_or(wheel.hangs, twisted);
        }
    }
    moving.push(cars, push, twist);
}
