//! Near lights by samples of incident radiance.

mod emitters;
mod harmonics;
mod polygon;
