//! Programs in C, C++ and Python on libvlaps: what is refused as they join, and sets that
//! they drive in.

mod joining;
mod languages;
mod set;
