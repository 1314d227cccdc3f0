use vehicle::Vehicle;

/// Discs that cover the car's rectangle.
pub(crate) const DISCS: usize = 5;

/// The car's rectangle as discs along its axis, and its reach.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Body {
    /// Middles of the discs, m ahead of the car's.
    pub(crate) offsets_m: [f64; DISCS],
    /// Their radius, m.
    pub(crate) radius_m: f64,
    /// Half the car's length and width, m.
    pub(crate) half_length_m: f64,
    pub(crate) half_width_m: f64,
}

impl Body {
    pub(crate) fn new(vehicle: &Vehicle) -> Self {
        let part_m = vehicle.length_m / DISCS as f64;
        let middle = (DISCS - 1) as f64 / 2.0;
        Self {
            offsets_m: std::array::from_fn(|disc| (disc as f64 - middle) * part_m),
            radius_m: (part_m / 2.0).hypot(vehicle.width_m / 2.0),
            half_length_m: vehicle.length_m / 2.0,
            half_width_m: vehicle.width_m / 2.0,
        }
    }
}
