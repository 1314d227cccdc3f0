//! The kinds of car that MetaDrive drives, and their measures
//! (`component/vehicle/vehicle_type.py`, `component/pg_space.py`).

use std::ops::Range;

use vehicle::Vehicle;

use crate::rng::Shared;

/// A kind of car.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum VehicleKind {
    /// The ego's car.
    Default,
    /// A small car.
    Small,
    /// A medium car.
    Medium,
    /// A large car.
    Large,
    /// A truck.
    ExtraLarge,
}

/// The measures of a kind of car.
#[derive(Clone, Debug, PartialEq)]
pub struct VehicleModel {
    /// MetaDrive's class name.
    pub name: &'static str,
    /// Length, m.
    pub length_m: f64,
    /// Width, m.
    pub width_m: f64,
    /// Height, m.
    pub height_m: f64,
    /// Mass, kg.
    pub mass_kg: f64,
    /// From the centre to the front axle, m.
    pub front_axle_m: f64,
    /// From the centre to the rear axle, m.
    pub rear_axle_m: f64,
    /// From the centre line to the wheels, m.
    pub half_track_m: f64,
    /// Wheel radius, m.
    pub wheel_radius_m: f64,
    /// Friction of the wheels.
    pub wheel_friction: f64,
    /// Largest wheel angle, degrees.
    pub max_steer_deg: f64,
    /// Range of the largest engine force per wheel, N.
    pub engine_force_n: Range<f64>,
    /// Range of the largest brake impulse per wheel and physics step, N s.
    pub brake_force: Range<f64>,
}

/// The sampled forces of one car.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Forces {
    /// Largest engine force per wheel, N.
    pub engine_n: f64,
    /// Largest brake impulse per wheel and physics step, as Bullet takes it.
    pub brake: f64,
}

impl VehicleKind {
    /// All kinds, by the number of the enumeration.
    pub const ALL: [VehicleKind; 5] = [
        VehicleKind::Default,
        VehicleKind::Small,
        VehicleKind::Medium,
        VehicleKind::Large,
        VehicleKind::ExtraLarge,
    ];

    /// The kinds that traffic draws from, with their weights.
    pub const TRAFFIC_WEIGHTS: [(VehicleKind, f64); 5] = [
        (VehicleKind::Small, 0.2),
        (VehicleKind::Medium, 0.3),
        (VehicleKind::Large, 0.3),
        (VehicleKind::ExtraLarge, 0.2),
        (VehicleKind::Default, 0.0),
    ];

    /// The measures of this kind.
    pub fn model(self) -> &'static VehicleModel {
        match self {
            VehicleKind::Default => &DEFAULT,
            VehicleKind::Small => &SMALL,
            VehicleKind::Medium => &MEDIUM,
            VehicleKind::Large => &LARGE,
            VehicleKind::ExtraLarge => &EXTRA_LARGE,
        }
    }

    /// Samples the forces of one car of this kind.
    pub(crate) fn forces(self, shared: Shared) -> Forces {
        let model = self.model();
        // From the top down: the simulator hands these bounds over in the
        // order (max, min) but writes them (min, max).
        let sample = |range: &Range<f64>| shared.within(range.end, range.start);
        Forces {
            engine_n: sample(&model.engine_force_n),
            brake: sample(&model.brake_force),
        }
    }
}

impl VehicleModel {
    /// The measures of a car of which only size, wheelbase and limits are known. The rest
    /// matters to collisions and pictures alone: it is the default car's, in proportion.
    pub(crate) fn of(vehicle: &Vehicle) -> VehicleModel {
        let wider = vehicle.width_m / DEFAULT.width_m;
        let longer = vehicle.length_m / DEFAULT.length_m;
        VehicleModel {
            name: "a vehicle file's",
            length_m: vehicle.length_m,
            width_m: vehicle.width_m,
            height_m: DEFAULT.height_m * wider,
            mass_kg: DEFAULT.mass_kg * longer * wider * wider,
            front_axle_m: vehicle.wheelbase_m / 2.0,
            rear_axle_m: vehicle.wheelbase_m / 2.0,
            half_track_m: DEFAULT.half_track_m * wider,
            wheel_radius_m: DEFAULT.wheel_radius_m * wider,
            max_steer_deg: vehicle.max_steer_deg,
            ..DEFAULT.clone()
        }
    }
}

static DEFAULT: VehicleModel = VehicleModel {
    name: "DefaultVehicle",
    length_m: 4.515,
    width_m: 1.852,
    height_m: 1.19,
    mass_kg: 1100.0,
    front_axle_m: 1.05234,
    rear_axle_m: 1.4166,
    half_track_m: 0.815,
    wheel_radius_m: 0.313,
    wheel_friction: 0.9,
    max_steer_deg: 40.0,
    engine_force_n: 750.0..850.0,
    brake_force: 80.0..180.0,
};

static SMALL: VehicleModel = VehicleModel {
    name: "SVehicle",
    length_m: 4.3,
    width_m: 1.7,
    height_m: 1.7,
    mass_kg: 800.0,
    front_axle_m: 1.385,
    rear_axle_m: 1.11,
    half_track_m: 0.7,
    wheel_radius_m: 0.376,
    wheel_friction: 0.9,
    max_steer_deg: 50.0,
    engine_force_n: 350.0..550.0,
    brake_force: 35.0..80.0,
};

static MEDIUM: VehicleModel = VehicleModel {
    name: "MVehicle",
    length_m: 4.6,
    width_m: 1.85,
    height_m: 1.37,
    mass_kg: 1200.0,
    front_axle_m: 1.285,
    rear_axle_m: 1.203,
    half_track_m: 0.803,
    wheel_radius_m: 0.39,
    wheel_friction: 0.75,
    max_steer_deg: 45.0,
    engine_force_n: 650.0..850.0,
    brake_force: 60.0..150.0,
};

static LARGE: VehicleModel = VehicleModel {
    name: "LVehicle",
    length_m: 4.87,
    width_m: 2.046,
    height_m: 1.85,
    mass_kg: 1300.0,
    front_axle_m: 1.5301,
    rear_axle_m: 1.218261,
    half_track_m: 0.75,
    wheel_radius_m: 0.429,
    wheel_friction: 0.8,
    max_steer_deg: 40.0,
    engine_force_n: 450.0..650.0,
    brake_force: 60.0..120.0,
};

static EXTRA_LARGE: VehicleModel = VehicleModel {
    name: "XLVehicle",
    length_m: 5.74,
    width_m: 2.3,
    height_m: 2.8,
    mass_kg: 1600.0,
    front_axle_m: 1.726,
    rear_axle_m: 1.075,
    half_track_m: 0.931,
    wheel_radius_m: 0.37,
    wheel_friction: 0.7,
    max_steer_deg: 35.0,
    engine_force_n: 500.0..700.0,
    brake_force: 50.0..100.0,
};
