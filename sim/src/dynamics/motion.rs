//! Where a car is and how it moves.

use nalgebra::{Matrix3, Vector3};
use vehicle::{Action, Point, Pose, Vector, pose};

use super::Car;
use crate::model::VehicleModel;

/// Where a car is and how it moves, in the world frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Centre of the chassis' floor, m.
    pub(super) position: Vector3<f64>,
    /// Forward, left and up axes as columns.
    pub(super) axes: Matrix3<f64>,
    /// m/s.
    pub(super) velocity: Vector3<f64>,
    /// rad/s.
    pub(super) spin: Vector3<f64>,
    /// Position, m, and direction of the pose that observations show.
    pub(super) seen_world: (Vector, Vector),
}

impl Motion {
    /// At rest at a pose, as MetaDrive places a car: its floor at half its
    /// height, from where it drops onto its springs.
    pub fn at_rest(world_from_body: Pose, model: &VehicleModel) -> Motion {
        let position = world_from_body.translation.vector;
        let heading_rad = world_from_body.rotation.angle();
        let (sin, cos) = heading_rad.sin_cos();
        Motion {
            position: Vector3::new(position.x, position.y, model.height_m / 2.0),
            axes: Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0),
            velocity: Vector3::zeros(),
            spin: Vector3::zeros(),
            seen_world: (position, Vector::new(cos, sin)),
        }
    }

    /// At rest at a pose, on settled springs.
    pub fn settled(world_from_body: Pose, car: &Car) -> Motion {
        let mut motion = Motion::at_rest(world_from_body, car.model);
        for _ in 0..20 {
            car.tick(&mut motion, Action::default());
        }
        motion.moved_to(world_from_body)
    }

    /// The same height, lean and vertical motion at another pose.
    pub fn moved_to(mut self, world_from_body: Pose) -> Motion {
        let position = world_from_body.translation.vector;
        let heading_rad = world_from_body.rotation.angle();
        let (sin, cos) = (heading_rad - self.heading_rad()).sin_cos();
        let turn = Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
        self.position = Vector3::new(position.x, position.y, self.position.z);
        self.axes = turn * self.axes;
        self.velocity = turn * self.velocity;
        self.spin = turn * self.spin;
        self.seen_world = (position, self.axes.column(0).xy());
        self
    }

    /// The same place with a horizontal velocity (m/s, world frame) and a yaw rate.
    pub fn with_velocity(mut self, velocity_world: Vector, yaw_rate_radps: f64) -> Motion {
        self.velocity.x = velocity_world.x;
        self.velocity.y = velocity_world.y;
        self.spin.z = yaw_rate_radps;
        self
    }

    /// The pose as observations give it: that of one sub-step before.
    pub fn seen(&self) -> Pose {
        pose(
            self.seen_world.0.x,
            self.seen_world.0.y,
            self.seen_heading_rad(),
        )
    }

    /// The same motion as it is seen when a share of a sub-step, [0, 1), has
    /// passed: the seen pose is that share of the way to the body's, as Bullet
    /// interpolates motion states between its fixed steps.
    pub fn between(mut self, passed: f64) -> Motion {
        if passed > 0.0 {
            let (position, forward) = self.seen_world;
            let body = (self.position.xy(), self.axes.column(0).xy());
            self.seen_world = (
                position + (body.0 - position) * passed,
                forward + (body.1 - forward) * passed,
            );
        }
        self
    }

    /// Position of [`Motion::seen`].
    pub fn seen_position(&self) -> Point {
        Point::from(self.seen_world.0)
    }

    /// Heading of [`Motion::seen`], rad, in (-pi, pi].
    pub fn seen_heading_rad(&self) -> f64 {
        self.seen_world.1.y.atan2(self.seen_world.1.x)
    }

    /// Unit vector along [`Motion::seen`].
    pub fn seen_forward(&self) -> Vector {
        self.seen_world.1.normalize()
    }

    /// The pose that contacts and beams meet.
    pub fn body(&self) -> Pose {
        pose(self.position.x, self.position.y, self.heading_rad())
    }

    /// Unit vector along [`Motion::body`].
    pub fn body_forward(&self) -> Vector {
        self.axes.column(0).xy().normalize()
    }

    /// Centre of [`Motion::body`].
    pub fn body_position(&self) -> Point {
        Point::new(self.position.x, self.position.y)
    }

    /// Height of the chassis' floor, m.
    pub fn floor_m(&self) -> f64 {
        self.position.z
    }

    /// Velocity over the ground, m/s, world frame.
    pub fn velocity_world(&self) -> Vector {
        self.velocity.xy()
    }

    /// Velocity of the point of the body that is at a place, m/s, world frame.
    pub fn velocity_at(&self, at_world: Point) -> Vector {
        let lever = at_world.coords - self.position.xy();
        self.velocity.xy() + Vector::new(-lever.y, lever.x) * self.spin.z
    }

    /// Speed over the ground, m/s, never negative.
    pub fn speed_mps(&self) -> f64 {
        self.velocity.xy().norm()
    }

    /// Speed along the heading, m/s.
    pub fn forward_mps(&self) -> f64 {
        self.velocity.xy().dot(&self.body_forward())
    }

    /// Moves the body without turning it, m, world frame: to part two bodies.
    pub fn displace(&mut self, offset_world: Vector) {
        self.position.x += offset_world.x;
        self.position.y += offset_world.y;
    }

    pub(super) fn heading_rad(&self) -> f64 {
        self.axes[(1, 0)].atan2(self.axes[(0, 0)])
    }
}
