//! Numbers in text that are read back bit by bit, also infinities and NaN, which JSON does
//! not have. For `#[serde(with = "exact")]`.

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serializer};

/// Writes the shortest text that names this number alone.
///
/// # Errors
/// Those of the serialiser.
pub fn serialize<S: Serializer>(number: &f64, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(&format!("{number:?}"))
}

/// Reads it.
///
/// # Errors
/// If the text is no number.
pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    let text = String::deserialize(deserializer)?;
    text.parse().map_err(D::Error::custom)
}

#[cfg(test)]
mod tests {
    use serde::{Deserialize, Serialize};

    #[derive(Serialize, Deserialize)]
    struct One(#[serde(with = "super")] f64);

    #[test]
    fn every_number_is_read_back_bit_by_bit() {
        let few = [
            0.0,
            -0.0,
            0.1,
            1.0 / 3.0,
            f64::MIN_POSITIVE,
            5e-324,
            f64::MAX,
        ];
        let many = (0..10_000_u64).map(|k| f64::from_bits(k.wrapping_mul(0x9e37_79b9_7f4a_7c15)));
        let odd = [f64::INFINITY, f64::NEG_INFINITY];
        for number in few.into_iter().chain(odd).chain(many) {
            let text = serde_json::to_string(&One(number)).expect("text");
            let One(read) = serde_json::from_str(&text).expect("a number");
            let is_same = read.to_bits() == number.to_bits() || read.is_nan() && number.is_nan();
            assert!(is_same, "{number:?}: {text}, {read:?}");
        }
        assert!(serde_json::from_str::<One>("\"three\"").is_err());
    }
}
