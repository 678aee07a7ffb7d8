//! Lobelia.
fn main() {}
