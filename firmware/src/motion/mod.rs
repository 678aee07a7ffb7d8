//! Motion: profiles limited in jerk ([`profile`], [`brake`]) in fixed point ([`fixed`]), the steps that follow them
//! ([`stepper`]), an axis with its pins and its approach from one side ([`axis`]), and what parameters are allowed
//! ([`parameters`]).

pub(crate) mod axis;
pub(crate) mod brake;
pub(crate) mod fixed;
pub(crate) mod parameters;
pub(crate) mod profile;
pub(crate) mod stepper;
