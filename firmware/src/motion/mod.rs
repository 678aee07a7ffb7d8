//! Motion: integer trapezoid ramps ([`stepper`]), an axis with its pins and its approach from one side ([`axis`]), and
//! what parameters are allowed ([`parameters`]).

pub(crate) mod axis;
pub(crate) mod parameters;
pub(crate) mod stepper;
