//! Whether a picture without noise of its own meets an error: judged by pictures of the path tracer, round by
//! round, until that is beyond doubt.
//!
//! A round is two pictures with seeds of their own, whose noise cancels in the mean of (a − r)(a − s)
//! (`compare::relative_square_by`); the spread of the rounds tells how well their mean is known.

use super::{judge, reference};
use crate::render::{Picture, Renderer, compare};
use crate::scene::{Scene, State};
use lobelia_base::error::Result;

/// Samples a pixel of a picture that judges: so few, since the mean is over many pixels.
const SAMPLES: u32 = 2;
/// Rounds before the spread tells anything, and at most.
const LEAST_ROUNDS: usize = 4;
const MOST_ROUNDS: usize = 24;
/// Rounds that are kept for the next picture to be judged.
const KEPT_ROUNDS: usize = 4;
/// Standard errors that are no doubt. As the rounds that they come from are few, one verdict in fifty is
/// wrong where the error is at the bound, and next to none where it is not.
const BEYOND_DOUBT: f64 = 4.0;

/// What judges the pictures of one frame.
pub(super) struct Judges<'a> {
    scene: &'a Scene,
    base: reference::Settings,
    frame: State,
    /// Pictures of the first rounds, and what errors are relative to.
    rounds: Vec<[Picture; 2]>,
    third: Picture,
}

impl<'a> Judges<'a> {
    /// Renders what errors are relative to.
    ///
    /// # Errors
    /// Those of the path tracer.
    pub(super) fn new(scene: &'a Scene, base: reference::Settings, frame: State) -> Result<Self> {
        let third = judge(&base, 3, 4 * SAMPLES).prepare(scene)?.frame(&frame)?.picture;
        Ok(Self { scene, base, frame, rounds: Vec::new(), third })
    }

    /// The picture's relative RMSE, and whether it is at most `max_error` beyond doubt.
    ///
    /// # Errors
    /// Those of the path tracer.
    pub(super) fn judge(&mut self, picture: &Picture, max_error: f64) -> Result<(f64, bool)> {
        let mut squares = Vec::new();
        loop {
            let round = squares.len();
            let fresh;
            let [first, second] = match self.rounds.get(round) {
                Some(kept) => kept,
                None => {
                    let of = |k| {
                        let seed = 4 + 2 * round as u64 + k;
                        Ok(judge(&self.base, seed, SAMPLES).prepare(self.scene)?.frame(&self.frame)?.picture)
                    };
                    let made = [of(0)?, of(1)?];
                    if round < KEPT_ROUNDS {
                        self.rounds.push(made);
                        &self.rounds[round]
                    } else {
                        fresh = made;
                        &fresh
                    }
                }
            };
            squares.push(compare::relative_square_by([first, second, &self.third], picture));
            let (square, verdict) = verdict(&squares, max_error * max_error);
            if verdict.is_some() || squares.len() == MOST_ROUNDS {
                // In doubt the picture is not taken.
                return Ok((square.max(0.0).sqrt(), verdict == Some(true)));
            }
        }
    }
}

/// The mean of estimates, and whether it is at most `bound` where that is beyond doubt.
fn verdict(estimates: &[f64], bound: f64) -> (f64, Option<bool>) {
    let count = estimates.len() as f64;
    let mean = estimates.iter().sum::<f64>() / count;
    if mean.is_nan() {
        return (mean, Some(false));
    }
    if estimates.len() < LEAST_ROUNDS {
        return (mean, None);
    }
    let spread: f64 = estimates.iter().map(|estimate| (estimate - mean).powi(2)).sum();
    let error = (spread / (count * (count - 1.0))).sqrt();
    let doubt = (mean - bound).abs() <= BEYOND_DOUBT * error && error > 0.0;
    (mean, (!doubt).then_some(mean <= bound))
}

#[cfg(test)]
mod tests {
    use super::*;
    use lobelia_base::random::Random;

    #[test]
    fn nothing_is_decided_by_few_rounds_or_at_the_bound_and_nan_is_no_picture() {
        assert_eq!(verdict(&[1.0; 3], 2.0).1, None);
        assert_eq!(verdict(&[1.0; 4], 2.0), (1.0, Some(true)));
        assert_eq!(verdict(&[3.0; 4], 2.0), (3.0, Some(false)));
        assert_eq!(verdict(&[1.9, 2.1, 2.0, 2.05], 2.0).1, None);
        assert_eq!(verdict(&[f64::NAN], 2.0).1, Some(false));
    }

    /// Rounds that scatter by as much as the bound itself: of 2,000 pictures at 0.7 and 1.4 times the bound
    /// at most 2 % are judged wrongly, where a single round is wrong for more than a quarter.
    #[test]
    fn noise_of_the_judges_seldom_decides() {
        let mut random = Random::new(7);
        let mut normal = || (0..12).map(|_| random.uniform(0.0, 1.0)).sum::<f64>() - 6.0;
        for (truth, met) in [(0.7, true), (1.4, false)] {
            let (mut wrong, mut at_once) = (0, 0);
            for _ in 0..2_000 {
                let mut rounds = Vec::new();
                let decided = loop {
                    rounds.push(truth + normal());
                    let (_, verdict) = verdict(&rounds, 1.0);
                    if verdict.is_some() || rounds.len() == MOST_ROUNDS {
                        break verdict;
                    }
                };
                wrong += u32::from(decided == Some(!met));
                at_once += u32::from((rounds[0] <= 1.0) != met);
            }
            assert!(wrong <= 40, "{wrong} of 2,000 at {truth}");
            assert!(at_once > 500, "{at_once}");
        }
    }
}
