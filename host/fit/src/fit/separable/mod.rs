//! The separable fit (variable projection, Golub and Pereyra 1973): given the shapes of the lobes, ρ_d and
//! the albedos of all channels are a small non-negative linear least squares problem with one matrix for all
//! channels; only the shapes are searched.
//!
//! It minimises Σ over samples k and channels c of s_c w_k (f̂ − f)², so it takes residuals that are linear
//! in f. The weights w belong to a sample, not to a channel: the proportional residual takes them from the
//! sample's luminance, and s_c makes up for how much darker or brighter the channel is on the whole.
//!
//! From the outside in: [`texel`] fits one texel, [`climb`] goes from simpler fits to larger ones, [`start`]
//! says what a fit is to be and follows neighbours, [`search`] finds where to begin, by the [`score`] of a
//! [`bank`] of shapes, [`solver`] optimises, [`normal`] does the small linear algebra on the products of the
//! [`columns`] that [`shape`] defines over the [`data`], with [`math`] that vectorises; [`extended`] has what
//! a model may have beyond plain lobes, and [`extend`] says when; [`robust`] weighs outliers less; [`bound`]
//! keeps directional albedos below 1, [`uncertainty`] says how sure the result is, [`choice`] how many lobes
//! it takes, [`mirror`] finds peaks that no lobe should be fitted to, [`levels`] gives texels that are fitted
//! together a ρ_d each, [`prior`] decides what the poses do not tell.

pub mod bank;
pub mod bound;
#[cfg(test)]
mod bound_tests;
pub mod choice;
pub mod climb;
pub mod columns;
pub mod data;
pub mod extend;
pub mod extended;
#[cfg(test)]
mod extended_tests;
pub mod form;
pub mod layout;
pub mod levels;
pub mod math;
pub mod mirror;
pub mod normal;
pub mod prior;
#[cfg(test)]
mod rig_tests;
pub mod robust;
pub mod score;
pub mod search;
pub mod shape;
pub mod solver;
pub mod start;
pub mod task;
#[cfg(test)]
mod tests;
pub mod texel;
pub mod uncertainty;
mod wild;
