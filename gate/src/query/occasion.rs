/// Why a question is asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Occasion {
    /// An episode begins, or a run whose clock starts anew.
    Episode,
    /// The period is over: `T_vlm` of Sec. 4.2.
    Period,
    /// The proposals differ by more than the threshold.
    Differ,
    /// One of them comes near something.
    Clearance,
}
