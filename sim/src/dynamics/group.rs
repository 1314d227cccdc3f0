//! A sub-step of several cars at once, a car in each lane of the machine's vectors.
//!
//! Each lane does the same operations in the same order as any other, so a car moves
//! alike alone, in company, and on every machine.

use nalgebra::{Matrix3, Vector3};
use pulp::{Simd, WithSimd};
use vehicle::Vector;

use super::wheels::{Moving, roll, suspend};
use super::{Car, Controls, GRAVITY_MPS2, Motion, SUBSTEP_S, UPRIGHT};
use crate::simd::{Lanes, Lanes3, Width};

/// Most cars of a group: a multiple of every vector's width.
pub(crate) const GROUP: usize = 8;

/// Most cars for vectors of half that width.
const NARROW: usize = 4;

/// Rows of a group: where the cars are and how they move.
const POSITION: usize = 0;
const FORWARD: usize = 3;
const LEFT: usize = 6;
const UP: usize = 9;
const VELOCITY: usize = 12;
const SPIN: usize = 15;
/// What observations show, written by a sub-step.
const SEEN: usize = 18;
/// What the drivers ask for.
pub(super) const STEER_SIN: usize = 22;
pub(super) const STEER_COS: usize = 23;
pub(super) const ENGINE: usize = 24;
pub(super) const BRAKE: usize = 25;
/// What the cars are.
pub(super) const MOUNT: usize = 26;
pub(super) const FRONT: usize = 27;
pub(super) const REAR: usize = 28;
pub(super) const HALF_TRACK: usize = 29;
pub(super) const WHEEL_RADIUS: usize = 30;
pub(super) const FRICTION: usize = 31;
pub(super) const MASS: usize = 32;
pub(super) const INVERSE_MASS: usize = 33;
pub(super) const INVERSE_INERTIA: usize = 34;
const ROWS: usize = 37;

/// Some cars and how they move, a car in each column.
#[derive(Clone, Debug)]
pub(crate) struct Group {
    rows: [[f64; GROUP]; ROWS],
    cars: usize,
}

impl Default for Group {
    fn default() -> Group {
        Group {
            rows: [[0.0; GROUP]; ROWS],
            cars: 0,
        }
    }
}

impl Group {
    /// Takes all cars out.
    pub fn clear(&mut self) {
        self.cars = 0;
    }

    /// Adds a car, which must fit.
    pub fn push(&mut self, car: &Car, motion: &Motion, controls: &Controls) {
        let axes = &motion.axes;
        for (row, vector) in [
            (POSITION, motion.position),
            (FORWARD, axes.column(0).into()),
            (LEFT, axes.column(1).into()),
            (UP, axes.column(2).into()),
            (VELOCITY, motion.velocity),
            (SPIN, motion.spin),
            (INVERSE_INERTIA, car.derived.inverse_inertia),
        ] {
            for (axis, &number) in vector.iter().enumerate() {
                self.rows[row + axis][self.cars] = number;
            }
        }
        for (row, number) in [
            (STEER_SIN, controls.steer_sin),
            (STEER_COS, controls.steer_cos),
            (ENGINE, controls.engine_n),
            (BRAKE, controls.brake_ns),
            (MOUNT, car.derived.mount_m),
            (FRONT, car.model.front_axle_m),
            (REAR, -car.model.rear_axle_m),
            (HALF_TRACK, car.model.half_track_m),
            (WHEEL_RADIUS, car.model.wheel_radius_m),
            (FRICTION, car.model.wheel_friction),
            (MASS, car.model.mass_kg),
            (INVERSE_MASS, car.derived.inverse_mass),
        ] {
            self.rows[row][self.cars] = number;
        }
        self.cars += 1;
    }

    /// Moves all cars by one sub-step.
    pub fn substep(&mut self, width: Width) {
        let arch = match self.cars <= NARROW {
            true => width.narrow,
            false => width.widest,
        };
        arch.dispatch(Substep(self));
    }

    /// The direction of a car that observations show; after the first sub-step.
    pub fn seen_direction(&self, car: usize) -> Vector {
        Vector::new(self.rows[SEEN + 2][car], self.rows[SEEN + 3][car])
    }

    /// How a car moves now; after the first sub-step.
    pub fn motion(&self, car: usize) -> Motion {
        let vector = |row: usize| {
            let [x, y, z] = [0, 1, 2].map(|axis| self.rows[row + axis][car]);
            Vector3::new(x, y, z)
        };
        let seen = |row: usize| Vector::new(self.rows[row][car], self.rows[row + 1][car]);
        Motion {
            position: vector(POSITION),
            axes: Matrix3::from_columns(&[vector(FORWARD), vector(LEFT), vector(UP)]),
            velocity: vector(VELOCITY),
            spin: vector(SPIN),
            seen_world: (seen(SEEN), seen(SEEN + 2)),
        }
    }
}

struct Substep<'a>(&'a mut Group);

impl WithSimd for Substep<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        for part in 0..self.0.cars.div_ceil(S::F64_LANES) {
            let rows = &mut self.0.rows;
            move_cars(&mut Columns { simd, rows, part });
        }
    }
}

/// As many columns as a vector has lanes.
pub(super) struct Columns<'a, S> {
    pub simd: S,
    rows: &'a mut [[f64; GROUP]; ROWS],
    part: usize,
}

impl<S: Simd> Columns<'_, S> {
    #[inline(always)]
    pub fn get(&self, row: usize) -> Lanes<S> {
        Lanes {
            simd: self.simd,
            of: S::as_simd_f64s(&self.rows[row]).0[self.part],
        }
    }

    #[inline(always)]
    fn set(&mut self, row: usize, lanes: Lanes<S>) {
        S::as_mut_simd_f64s(&mut self.rows[row]).0[self.part] = lanes.of;
    }

    #[inline(always)]
    pub fn vector(&self, row: usize) -> Lanes3<S> {
        Lanes3 {
            x: self.get(row),
            y: self.get(row + 1),
            z: self.get(row + 2),
        }
    }

    #[inline(always)]
    fn set_vector(&mut self, row: usize, vector: Lanes3<S>) {
        self.set(row, vector.x);
        self.set(row + 1, vector.y);
        self.set(row + 2, vector.z);
    }
}

/// One sub-step of the cars in these columns.
#[inline(always)]
fn move_cars<S: Simd>(cars: &mut Columns<S>) {
    let (position, velocity) = (cars.vector(POSITION), cars.vector(VELOCITY));
    let (forward, left) = (cars.vector(FORWARD), cars.vector(LEFT));
    let spin = cars.vector(SPIN);
    cars.set(SEEN, position.x);
    cars.set(SEEN + 1, position.y);
    cars.set(SEEN + 2, forward.x);
    cars.set(SEEN + 3, forward.y);
    let velocity = Lanes3 {
        z: velocity.z - GRAVITY_MPS2 * SUBSTEP_S,
        ..velocity
    };
    let position = position + velocity * SUBSTEP_S;
    let [forward, left, up] = turn([forward, left], spin);
    // Velocities in the chassis' own axes.
    let mut moving = Moving {
        velocity: Lanes3 {
            x: forward.dot(velocity),
            y: left.dot(velocity),
            z: up.dot(velocity),
        },
        spin: Lanes3 {
            x: forward.dot(spin),
            y: left.dot(spin),
            z: up.dot(spin),
        },
    };
    let world_up = Lanes3 {
        x: forward.z,
        y: left.z,
        z: up.z,
    };
    let lying = moving;
    let wheels = suspend(cars, position.z, world_up, &mut moving);
    roll(cars, &wheels, world_up, &mut moving);
    // On its side or roof no wheel finds the ground.
    let upright = Lanes::of(cars.simd, UPRIGHT).is_below(world_up.z);
    let moved = moving.velocity.where_or(upright, lying.velocity);
    let spun = moving.spin.where_or(upright, lying.spin);
    cars.set_vector(POSITION, position);
    cars.set_vector(FORWARD, forward);
    cars.set_vector(LEFT, left);
    cars.set_vector(UP, up);
    cars.set_vector(VELOCITY, forward * moved.x + left * moved.y + up * moved.z);
    cars.set_vector(SPIN, forward * spun.x + left * spun.y + up * spun.z);
}

/// The axes after a rotation by the spin; they stay orthonormal.
#[inline(always)]
fn turn<S: Simd>([forward, left]: [Lanes3<S>; 2], spin: Lanes3<S>) -> [Lanes3<S>; 3] {
    let angle = spin * SUBSTEP_S;
    let square = angle.dot(angle);
    // Rodrigues with both coefficients to the fourth order: the angle of
    // one sub-step stays below 0.2 rad, so the rest is below 1e-8.
    let sine = 1.0 - square / 6.0 * (1.0 - square / 20.0);
    let cosine = 0.5 - square / 24.0 * (1.0 - square / 30.0);
    let forward = unit(turned(forward, angle, [sine, cosine]));
    let left = turned(left, angle, [sine, cosine]);
    let left = unit(left - forward * forward.dot(left));
    [forward, left, forward.cross(left)]
}

#[inline(always)]
fn turned<S: Simd>(axis: Lanes3<S>, angle: Lanes3<S>, [sine, cosine]: [Lanes<S>; 2]) -> Lanes3<S> {
    let across = angle.cross(axis);
    axis + across * sine + angle.cross(across) * cosine
}

/// One Newton step keeps the axes of unit length without a root.
#[inline(always)]
fn unit<S: Simd>(axis: Lanes3<S>) -> Lanes3<S> {
    axis * (1.5 - 0.5 * axis.dot(axis))
}

#[cfg(test)]
mod tests {
    use vehicle::{Action, pose};

    use super::*;
    use crate::model::{Forces, VehicleKind};

    /// A car of each kind and some more, on four wheels, in the air, on its side.
    fn cars() -> Vec<(Car, Motion, Controls)> {
        let forces = Forces {
            engine_n: 700.0,
            brake: 90.0,
        };
        let cars = (0..GROUP).map(|k| {
            let share = k as f64 / GROUP as f64;
            let kind = VehicleKind::ALL[k % VehicleKind::ALL.len()];
            let car = Car::new(kind, forces);
            let at = pose(share, -share, 6.0 * share);
            let velocity = Vector::new(20.0 * share, 3.0 - share);
            let mut motion = Motion::at_rest(at, car.model).with_velocity(velocity, share);
            if k == 5 {
                // On its side: forward, down, left.
                motion.axes = Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, -1.0, 0.0);
            }
            let action = Action {
                steer: 1.0 - 2.0 * share,
                pedal: 0.9 - 2.0 * share,
            };
            (car, motion, car.controls(&motion, action))
        });
        cars.collect()
    }

    #[test]
    fn a_car_moves_alike_alone_and_in_company_on_every_machine() {
        let mut alone = cars();
        for members in [1, 3, GROUP] {
            for width in [Width::default(), Width::SCALAR] {
                let mut group = Group::default();
                for (car, motion, controls) in &cars()[..members] {
                    group.push(car, motion, controls);
                }
                alone.clone_from(&cars());
                for substep in 0..300 {
                    group.substep(width);
                    for (column, (car, motion, controls)) in alone[..members].iter_mut().enumerate()
                    {
                        car.substep(motion, controls);
                        let together = group.motion(column);
                        assert_eq!(together, *motion, "car {column}, sub-step {substep}");
                        assert!(motion.speed_mps().is_finite(), "car {column}");
                    }
                }
            }
        }
        let moved = alone.iter().map(|(_, motion, _)| motion.speed_mps());
        assert!(moved.fold(0.0, f64::max) > 5.0, "they drive");
    }
}
