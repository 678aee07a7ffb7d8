//! Lobelia.
