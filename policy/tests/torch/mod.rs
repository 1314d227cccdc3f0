//! What PyTorch answered, as `data/export.py` printed it.

/// An input and PyTorch's answer to it.
pub struct Case {
    /// 259 features.
    pub features: Vec<f32>,
    /// Steering and pedal.
    pub answer: [f32; 2],
}

/// Reads the lines `FACTOR STEER PEDAL` of a file: the features are a sine of
/// that factor.
///
/// # Panics
/// When a line is none.
pub fn cases(text: &str) -> impl Iterator<Item = Case> {
    text.lines().map(|line| {
        let numbers: Vec<f32> = line
            .split(' ')
            .map(|number| number.parse().expect("a number"))
            .collect();
        Case {
            features: (0..259)
                .map(|k| (k as f32 * numbers[0]).sin().abs())
                .collect(),
            answer: [numbers[1], numbers[2]],
        }
    })
}
