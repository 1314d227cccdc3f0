//! The vectors of this machine, and numbers that lie in their lanes.
//!
//! Lanes do what plain numbers do, in the same order and without fusing a product and a
//! sum, so the width changes no bit of a result.

use std::ops::{Add, Div, Mul, Neg, Sub};

use pulp::{Arch, Simd};

/// The vectors of this machine.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Width {
    /// The widest.
    pub widest: Arch,
    /// Those of at most four numbers, which divide faster.
    pub narrow: Arch,
}

impl Width {
    /// No vectors at all.
    pub const SCALAR: Width = Width {
        widest: Arch::Scalar,
        narrow: Arch::Scalar,
    };
}

impl Default for Width {
    fn default() -> Width {
        let widest = Arch::new();
        #[cfg(target_arch = "x86_64")]
        let narrow = pulp::x86::V3::try_new().map_or(widest, Arch::V3);
        #[cfg(not(target_arch = "x86_64"))]
        let narrow = widest;
        Width { widest, narrow }
    }
}

impl PartialEq for Width {
    fn eq(&self, _: &Width) -> bool {
        // It changes no result.
        true
    }
}

/// One number for each lane.
#[derive(Clone, Copy)]
pub(crate) struct Lanes<S: Simd> {
    pub simd: S,
    pub of: S::f64s,
}

macro_rules! operator {
    ($trait:ident, $name:ident, $lanes:ident) => {
        impl<S: Simd> $trait for Lanes<S> {
            type Output = Self;

            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                Lanes {
                    simd: self.simd,
                    of: self.simd.$lanes(self.of, other.of),
                }
            }
        }

        impl<S: Simd> $trait<f64> for Lanes<S> {
            type Output = Self;

            #[inline(always)]
            fn $name(self, other: f64) -> Self {
                self.$name(Lanes::of(self.simd, other))
            }
        }

        impl<S: Simd> $trait<Lanes<S>> for f64 {
            type Output = Lanes<S>;

            #[inline(always)]
            fn $name(self, other: Lanes<S>) -> Lanes<S> {
                Lanes::of(other.simd, self).$name(other)
            }
        }
    };
}

operator!(Add, add, add_f64s);
operator!(Sub, sub, sub_f64s);
operator!(Mul, mul, mul_f64s);
operator!(Div, div, div_f64s);

impl<S: Simd> Neg for Lanes<S> {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        Lanes {
            simd: self.simd,
            of: self.simd.neg_f64s(self.of),
        }
    }
}

impl<S: Simd> Lanes<S> {
    /// The same number in all lanes.
    #[inline(always)]
    pub fn of(simd: S, number: f64) -> Self {
        Lanes {
            simd,
            of: simd.splat_f64s(number),
        }
    }

    #[inline(always)]
    pub fn sqrt(self) -> Self {
        Lanes {
            simd: self.simd,
            of: self.simd.sqrt_f64s(self.of),
        }
    }

    /// Where it is less than a number.
    #[inline(always)]
    pub fn is_below(self, other: Self) -> S::m64s {
        self.simd.less_than_f64s(self.of, other.of)
    }

    /// Where it is equal to a number.
    #[inline(always)]
    pub fn is(self, other: f64) -> S::m64s {
        let other = self.simd.splat_f64s(other);
        self.simd.equal_f64s(self.of, other)
    }

    /// These numbers where the mask is set, the others elsewhere.
    #[inline(always)]
    pub fn where_or(self, mask: S::m64s, other: Self) -> Self {
        Lanes {
            simd: self.simd,
            of: self.simd.select_f64s(mask, self.of, other.of),
        }
    }

    /// The lesser of both.
    #[inline(always)]
    pub fn at_most(self, most: f64) -> Self {
        let most = Lanes::of(self.simd, most);
        most.where_or(most.is_below(self), self)
    }

    /// The greater of both.
    #[inline(always)]
    pub fn at_least(self, least: f64) -> Self {
        let least = Lanes::of(self.simd, least);
        least.where_or(self.is_below(least), self)
    }

    /// Within -limit and limit.
    #[inline(always)]
    pub fn within(self, limit: Self) -> Self {
        let raised = (-limit).where_or(self.is_below(-limit), self);
        limit.where_or(limit.is_below(raised), raised)
    }
}

/// A vector of space for each lane.
#[derive(Clone, Copy)]
pub(crate) struct Lanes3<S: Simd> {
    pub x: Lanes<S>,
    pub y: Lanes<S>,
    pub z: Lanes<S>,
}

impl<S: Simd> Lanes3<S> {
    #[inline(always)]
    pub fn zero(simd: S) -> Self {
        let zero = Lanes::of(simd, 0.0);
        Lanes3 {
            x: zero,
            y: zero,
            z: zero,
        }
    }

    #[inline(always)]
    pub fn dot(self, other: Self) -> Lanes<S> {
        self.x * other.x + self.y * other.y + self.z * other.z
    }

    #[inline(always)]
    pub fn cross(self, other: Self) -> Self {
        Lanes3 {
            x: self.y * other.z - self.z * other.y,
            y: self.z * other.x - self.x * other.z,
            z: self.x * other.y - self.y * other.x,
        }
    }

    /// The products of the components.
    #[inline(always)]
    pub fn times(self, other: Self) -> Self {
        Lanes3 {
            x: self.x * other.x,
            y: self.y * other.y,
            z: self.z * other.z,
        }
    }

    #[inline(always)]
    pub fn normalize(self) -> Self {
        let norm = self.dot(self).sqrt();
        Lanes3 {
            x: self.x / norm,
            y: self.y / norm,
            z: self.z / norm,
        }
    }

    /// This vector where the mask is set, the other elsewhere.
    #[inline(always)]
    pub fn where_or(self, mask: S::m64s, other: Self) -> Self {
        Lanes3 {
            x: self.x.where_or(mask, other.x),
            y: self.y.where_or(mask, other.y),
            z: self.z.where_or(mask, other.z),
        }
    }
}

impl<S: Simd> Add for Lanes3<S> {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Lanes3 {
            x: self.x + other.x,
            y: self.y + other.y,
            z: self.z + other.z,
        }
    }
}

impl<S: Simd> Sub for Lanes3<S> {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Lanes3 {
            x: self.x - other.x,
            y: self.y - other.y,
            z: self.z - other.z,
        }
    }
}

impl<S: Simd> Mul<Lanes<S>> for Lanes3<S> {
    type Output = Self;

    #[inline(always)]
    fn mul(self, factor: Lanes<S>) -> Self {
        Lanes3 {
            x: self.x * factor,
            y: self.y * factor,
            z: self.z * factor,
        }
    }
}

impl<S: Simd> Mul<f64> for Lanes3<S> {
    type Output = Self;

    #[inline(always)]
    fn mul(self, factor: f64) -> Self {
        self * Lanes::of(self.x.simd, factor)
    }
}
