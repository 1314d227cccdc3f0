//! Message layouts that describe themselves.
//!
//! [`message!`](macro@crate::message) records each field's name, type and offset beside the
//! struct. From this table come the layout's fingerprint, by which a producer and a
//! consumer built from different sources refuse each other, and the layout in other
//! languages, which therefore cannot differ.

/// One field of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Field {
    /// The field's name.
    pub name: &'static str,
    /// Its type as written in the source, such as `f64` or `[Waypoint; 64]`.
    pub type_name: &'static str,
    /// Bytes from the start of the message.
    pub offset: usize,
    /// Bytes.
    pub size: usize,
    /// What it is: the lines of the doc comment in the source.
    /// No part of the fingerprint.
    pub doc: &'static [&'static str],
}

/// The field table of a message, with those of the messages nested in it.
#[derive(Debug, PartialEq, Eq)]
pub struct Table {
    /// The name on the wire.
    pub name: &'static str,
    /// The fields in order.
    pub fields: &'static [Field],
    /// The tables of the types among them.
    pub nested: &'static [&'static Table],
}

/// A type with a pinned layout.
pub trait Layout {
    /// The name on the wire, the same in every language.
    const NAME: &'static str;
    /// The fields in order; no padding between or after them.
    const FIELDS: &'static [Field];
    /// A hash of the names, types and offsets of all fields, nested ones too.
    const FINGERPRINT: u64;
    /// The fields, nested ones too.
    const TABLE: &'static Table;

    /// The memory of the message.
    fn as_bytes(&self) -> &[u8];

    /// The message of this memory, unchecked; `None` when its length is not the message's.
    /// For messages of megabytes use [`Layout::copy_from`], which needs no stack.
    fn from_bytes(bytes: &[u8]) -> Option<Self>
    where
        Self: Sized;

    /// Overwrites the message with this memory, unchecked; returns whether its length is
    /// the message's, else nothing changes.
    fn copy_from(&mut self, bytes: &[u8]) -> bool;
}

/// A type of which every pattern of bytes is a value.
///
/// # Safety
/// Numbers, arrays of them, and structs without padding made of both.
#[allow(unsafe_code)]
pub unsafe trait Plain: Copy + 'static {}

macro_rules! plain {
    ($($number:ty),+) => { $(
        // SAFETY: a number.
        #[allow(unsafe_code)]
        unsafe impl Plain for $number {}
    )+ };
}
plain!(u8, u32, u64, f32, f64);
// SAFETY: an array has no padding of its own.
#[allow(unsafe_code)]
unsafe impl<T: Plain, const N: usize> Plain for [T; N] {}

/// FNV-1a, a hash simple enough for a `const`. It distinguishes layouts and protects
/// nothing.
pub const fn fnv1a(mut hash: u64, bytes: &[u8]) -> u64 {
    let mut k = 0;
    while k < bytes.len() {
        hash = (hash ^ bytes[k] as u64).wrapping_mul(0x0000_0100_0000_01b3);
        k += 1;
    }
    hash
}

/// The offset basis of FNV-1a.
pub const FNV_BASIS: u64 = 0xcbf2_9ce4_8422_2325;

/// The fingerprint of a field table.
pub const fn fingerprint(name: &str, fields: &[Field]) -> u64 {
    let mut hash = fnv1a(FNV_BASIS, name.as_bytes());
    let mut k = 0;
    while k < fields.len() {
        hash = fnv1a(hash, fields[k].name.as_bytes());
        hash = fnv1a(hash, fields[k].type_name.as_bytes());
        hash = fnv1a(hash, &(fields[k].offset as u64).to_le_bytes());
        hash = fnv1a(hash, &(fields[k].size as u64).to_le_bytes());
        k += 1;
    }
    hash
}

/// Whether the fields fill `size` bytes without a gap. Then no byte of a message is
/// undefined, and messages can be hashed, recorded and compared bit by bit.
pub const fn is_packed(fields: &[Field], size: usize) -> bool {
    let mut end = 0;
    let mut k = 0;
    while k < fields.len() {
        if fields[k].offset != end {
            return false;
        }
        end += fields[k].size;
        k += 1;
    }
    end == size
}

/// Declares a message: `#[repr(C)]`, every field public, its size pinned, its
/// layout recorded. Fields have doc comments and no other attributes: the comments are in
/// the layout, too, for other languages.
///
/// Fields of a nested message type are listed after `nested`, so that a change
/// inside one changes the fingerprint of everything that holds it.
#[macro_export]
macro_rules! message {
    (
        $(#[$meta:meta])*
        pub struct $name:ident: $size:literal bytes $(, nested [$($nested:ty),+])? {
            $( $(#[doc = $doc:literal])* pub $field:ident: $type:ty, )+
        }
    ) => {
        $(#[$meta])*
        #[derive(Debug, Clone, Copy, PartialEq)]
        #[repr(C)]
        pub struct $name {
            $( $(#[doc = $doc])* pub $field: $type, )+
        }

        impl $crate::layout::Layout for $name {
            const NAME: &'static str = stringify!($name);
            const FIELDS: &'static [$crate::layout::Field] = &[
                $( $crate::layout::Field {
                    name: stringify!($field),
                    type_name: stringify!($type),
                    offset: core::mem::offset_of!($name, $field),
                    size: {
                        const fn size_of_field<T, F>(_: fn(&T) -> &F) -> usize {
                            size_of::<F>()
                        }
                        size_of_field(|message: &$name| &message.$field)
                    },
                    doc: &[ $( $doc, )* ],
                }, )+
            ];
            const FINGERPRINT: u64 = {
                #[allow(unused_mut)]
                let mut hash = $crate::layout::fingerprint(stringify!($name), Self::FIELDS);
                $( $( hash = $crate::layout::fnv1a(
                    hash,
                    &<$nested as $crate::layout::Layout>::FINGERPRINT.to_le_bytes(),
                ); )+ )?
                hash
            };
            const TABLE: &'static $crate::layout::Table = &$crate::layout::Table {
                name: stringify!($name),
                fields: Self::FIELDS,
                nested: &[$( $( <$nested as $crate::layout::Layout>::TABLE, )+ )?],
            };

            #[allow(unsafe_code)]
            fn as_bytes(&self) -> &[u8] {
                // SAFETY: `repr(C)` without padding (asserted below), so every byte is
                // defined; the slice lives no longer than the borrow.
                unsafe {
                    core::slice::from_raw_parts(
                        core::ptr::from_ref(self).cast::<u8>(),
                        size_of::<$name>(),
                    )
                }
            }

            #[allow(unsafe_code)]
            fn from_bytes(bytes: &[u8]) -> Option<Self> {
                if bytes.len() != size_of::<$name>() {
                    return None;
                }
                // SAFETY: the length is the message's, an unaligned read needs no more, and
                // every pattern of bytes is a message (`Plain`, asserted below).
                Some(unsafe { bytes.as_ptr().cast::<$name>().read_unaligned() })
            }

            #[allow(unsafe_code)]
            fn copy_from(&mut self, bytes: &[u8]) -> bool {
                let fits = bytes.len() == size_of::<$name>();
                if fits {
                    // SAFETY: as above; the message is borrowed for writing, so the two
                    // cannot overlap.
                    unsafe {
                        core::ptr::copy_nonoverlapping(
                            bytes.as_ptr(),
                            core::ptr::from_mut(self).cast::<u8>(),
                            bytes.len(),
                        );
                    }
                }
                fits
            }
        }

        // SAFETY: without padding, and of plain fields alone (both asserted here).
        #[allow(unsafe_code)]
        unsafe impl $crate::layout::Plain for $name {}
        const _: () = {
            const fn plain<T: $crate::layout::Plain>() {}
            $( plain::<$type>(); )+
        };

        $crate::travels! { $name: $( $type, )+ }

        const _: () = assert!(
            size_of::<$name>() == $size,
            concat!("the size of ", stringify!($name), " is pinned at ", stringify!($size), " bytes"),
        );
        const _: () = assert!(
            $crate::layout::is_packed(<$name as $crate::layout::Layout>::FIELDS, size_of::<$name>()),
            concat!(stringify!($name), " has padding: order or fill its fields"),
        );
    };
}

/// Makes a message fit for shared memory, where the wire is built.
#[cfg(feature = "wire")]
#[doc(hidden)]
#[macro_export]
macro_rules! travels {
    ($name:ident: $( $type:ty, )+) => {
        // SAFETY: `repr(C)`, `Copy`, without padding (asserted by `message!`), and every
        // field can travel (asserted here), so no field holds a pointer.
        #[allow(unsafe_code)]
        unsafe impl $crate::layout::Travels for $name {
            unsafe fn type_name() -> &'static str {
                stringify!($name)
            }
        }
        const _: () = {
            const fn travels<T: $crate::layout::Travels>() {}
            $( travels::<$type>(); )+
        };
    };
}

/// Without the wire no message is sent.
#[cfg(not(feature = "wire"))]
#[doc(hidden)]
#[macro_export]
macro_rules! travels {
    ($name:ident: $( $type:ty, )+) => {};
}

#[cfg(feature = "wire")]
#[allow(clippy::disallowed_types)]
pub use iceoryx2::prelude::ZeroCopySend as Travels;

/// The types that may be sent through shared memory; checked where the wire is built.
#[cfg(not(feature = "wire"))]
pub trait Travels {}
#[cfg(not(feature = "wire"))]
impl<T> Travels for T {}

/// Declares a closed list that is sent as a `u32`, with the word that users read.
#[macro_export]
macro_rules! word_list {
    (
        $(#[$meta:meta])*
        pub enum $name:ident { $( $(#[$variant_meta:meta])* $variant:ident = $code:literal $word:literal, )+ }
    ) => {
        $(#[$meta])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        #[repr(u32)]
        pub enum $name { $( $(#[$variant_meta])* $variant = $code, )+ }

        impl $name {
            /// Every value, in order of code.
            pub const ALL: &'static [Self] = &[$( Self::$variant, )+];

            /// The value on the wire.
            pub const fn code(self) -> u32 {
                self as u32
            }

            /// The value of a code; `None` when the list has no such code.
            pub const fn from_code(code: u32) -> Option<Self> {
                match code {
                    $( $code => Some(Self::$variant), )+
                    _ => None,
                }
            }

            /// The word users read.
            pub const fn word(self) -> &'static str {
                match self { $( Self::$variant => $word, )+ }
            }
        }

        impl core::fmt::Display for $name {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                f.pad(self.word())
            }
        }
    };
}
