//! The ego's car where it is not MetaDrive's.

use std::sync::{Mutex, PoisonError};

use vehicle::Vehicle;

use super::Derived;
use crate::model::VehicleModel;

/// A car of a vehicle file, with what follows from its measures.
#[derive(Debug)]
pub(super) struct OwnCar {
    pub vehicle: Vehicle,
    pub model: VehicleModel,
    pub derived: Derived,
}

/// Every car of this program so far. All worlds share them, as they share the kinds of
/// MetaDrive; a program drives few different ones, so they are never freed.
static CARS: Mutex<Vec<&'static OwnCar>> = Mutex::new(Vec::new());

/// The car of these measures; `None` for MetaDrive's default car.
pub(super) fn shared(vehicle: &Vehicle) -> Option<&'static OwnCar> {
    let vehicle = Vehicle {
        delay_ms: Vehicle::default().delay_ms,
        ..*vehicle
    };
    if vehicle == Vehicle::default() {
        return None;
    }
    // A panic between lock and push leaves the list whole.
    let mut cars = CARS.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(own) = cars.iter().find(|own| own.vehicle == vehicle) {
        return Some(own);
    }
    let model = VehicleModel::of(&vehicle);
    let own: &'static OwnCar = Box::leak(Box::new(OwnCar {
        vehicle,
        derived: Derived::of_model(&model, 0.0),
        model,
    }));
    cars.push(own);
    Some(own)
}
