//! The keys of a human driver.

/// A key with an effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Key {
    /// Takes over, or gives back.
    Switch,
    /// Gives back.
    GiveBack,
    /// Steers left.
    Left,
    /// Steers right.
    Right,
    /// Gives gas.
    Gas,
    /// Brakes.
    Brake,
}
