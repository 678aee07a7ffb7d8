//! Motion: profiles limited in jerk ([`profile`], [`brake`]) in fixed point ([`fixed`]); the plan of the
//! steps that follow them ([`stepper`]), handed over in bursts ([`burst`]) to what tells when pins change
//! ([`trains`]); those pins ([`pulses`]); an axis with its approach from one side ([`axis`]); when plans may
//! change ([`changes`]); where axes must not be together ([`keep_out`]), and what parameters are allowed
//! ([`parameters`]).

pub(crate) mod axis;
pub(crate) mod brake;
pub(crate) mod burst;
pub(crate) mod changes;
pub(crate) mod fixed;
pub(crate) mod keep_out;
pub(crate) mod parameters;
pub(crate) mod profile;
pub(crate) mod pulses;
pub(crate) mod stepper;
pub(crate) mod trains;
