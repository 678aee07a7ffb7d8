//! Small convex quadratic programmes: least squares by their normal equations, under linear inequalities.
//!
//! The dual method of Goldfarb and Idnani (1983): from the unconstrained minimum, the inequality that is
//! violated most is made to hold, one after the other, while those that no longer press are let go.
//! Everything is solved anew at each step: there are at most [`MOST_UNKNOWNS`] unknowns.

use super::linear::{self, MOST_UNKNOWNS};

/// Steps at most; far more than there are inequalities that can hold at once.
const STEPS: usize = 200;
/// An inequality that is scaled to a right side about 1 holds when it is violated by no more than this.
const VIOLATED: f64 = 1e-10;

/// An inequality aᵀ x ≤ b.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Inequality {
    /// a; places beyond the unknowns are 0.
    pub row: [f64; MOST_UNKNOWNS],
    /// b.
    pub most: f64,
}

/// The minimum.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Minimum {
    /// The unknowns.
    pub x: [f64; MOST_UNKNOWNS],
    /// Places of the inequalities that hold with equality, and their multipliers, > 0.
    pub active: [(usize, f64); MOST_UNKNOWNS],
    /// How many those are.
    pub count: usize,
}

impl Minimum {
    /// The inequalities that hold with equality, with their multipliers.
    pub(crate) fn pressing(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        self.active[..self.count].iter().copied()
    }
}

type Vector = [f64; MOST_UNKNOWNS];

/// Minimises ½ xᵀ H x − rhsᵀ x where all inequalities hold; H symmetric positive definite, row by row. None
/// where H is not, or no x meets the inequalities.
pub(crate) fn minimise(hessian: &[f64], rhs: &[f64], inequalities: &[Inequality]) -> Option<Minimum> {
    let size = rhs.len();
    let mut factor = [0.0; MOST_UNKNOWNS * MOST_UNKNOWNS];
    let factor = &mut factor[..size * size];
    factor.copy_from_slice(hessian);
    if !linear::factor(factor, size) {
        return None;
    }
    let solve = |v: &Vector| {
        let mut x = *v;
        linear::substitute(factor, &mut x[..size]);
        x
    };
    let dot = |a: &Vector, b: &Vector| (0..size).map(|i| a[i] * b[i]).sum::<f64>();
    let mut start = [0.0; MOST_UNKNOWNS];
    start[..size].copy_from_slice(rhs);
    let mut found = Minimum { x: solve(&start), active: [(0, 0.0); MOST_UNKNOWNS], count: 0 };
    let mut adding: Option<(usize, f64)> = None;
    for _ in 0..STEPS {
        let (place, multiplier) = match adding {
            Some(adding) => adding,
            None => {
                let excess = |k: usize| dot(&inequalities[k].row, &found.x) - inequalities[k].most;
                let worst = (0..inequalities.len())
                    .filter(|k| found.pressing().all(|(active, _)| active != *k))
                    .map(|k| (k, excess(k) / (1.0 + inequalities[k].most.abs())))
                    .max_by(|a, b| a.1.total_cmp(&b.1));
                match worst {
                    Some((k, excess)) if excess > VIOLATED => (k, 0.0),
                    _ => return Some(found),
                }
            }
        };
        let Inequality { row, most } = inequalities[place];
        let (step, rates) = directions(&solve, &found, inequalities, &row, size)?;
        // How far the multipliers allow to go, and how far the inequality asks to.
        let allowed = (0..found.count)
            .filter(|&k| rates[k] > 0.0)
            .map(|k| (found.active[k].1 / rates[k], k))
            .min_by(|a, b| a.0.total_cmp(&b.0));
        let slope = dot(&row, &step);
        let asked = if slope < -1e-14 * dot(&row, &solve(&row)) {
            (dot(&row, &found.x) - most) / -slope
        } else {
            f64::INFINITY
        };
        let length = allowed.map_or(asked, |(length, _)| length.min(asked));
        if !length.is_finite() {
            return None;
        }
        if asked.is_finite() {
            (0..size).for_each(|i| found.x[i] += length * step[i]);
        }
        (0..found.count).for_each(|k| found.active[k].1 -= length * rates[k]);
        if length == asked {
            found.active[found.count] = (place, multiplier + length);
            found.count += 1;
            adding = None;
        } else {
            let (_, released) = allowed?;
            found.active.copy_within(released + 1..found.count, released);
            found.count -= 1;
            adding = Some((place, multiplier + length));
        }
    }
    None
}

/// The way on which the inequality `row` is met while the active ones hold, for a multiplier of 1, and the
/// rates at which their multipliers fall.
fn directions(
    solve: &impl Fn(&Vector) -> Vector,
    found: &Minimum,
    inequalities: &[Inequality],
    row: &Vector,
    size: usize,
) -> Option<(Vector, Vector)> {
    let count = found.count;
    let dot = |a: &Vector, b: &Vector| (0..size).map(|i| a[i] * b[i]).sum::<f64>();
    let mut step = solve(row).map(|x| -x);
    let mut rates = [0.0; MOST_UNKNOWNS];
    if count > 0 {
        let rows: [Vector; MOST_UNKNOWNS] = std::array::from_fn(|k| {
            if k < count { inequalities[found.active[k].0].row } else { [0.0; MOST_UNKNOWNS] }
        });
        let mut solved = [[0.0; MOST_UNKNOWNS]; MOST_UNKNOWNS];
        let mut products = [0.0; MOST_UNKNOWNS * MOST_UNKNOWNS];
        for k in 0..count {
            solved[k] = solve(&rows[k]);
            for j in 0..=k {
                products[k * count + j] = dot(&rows[j], &solved[k]);
                products[j * count + k] = products[k * count + j];
            }
            products[k * count + k] *= 1.0 + 1e-13;
            rates[k] = dot(row, &solved[k]);
        }
        if !linear::solve_spd(&mut products[..count * count], &mut rates[..count]) {
            return None;
        }
        for k in 0..count {
            (0..size).for_each(|i| step[i] += rates[k] * solved[k][i]);
        }
    }
    if count == size {
        step = [0.0; MOST_UNKNOWNS];
    }
    Some((step, rates))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SIZE: usize = 4;

    proptest! {
        #[test]
        fn the_minimum_meets_the_optimality_conditions(
            rows in prop::collection::vec(prop::array::uniform4(-1f64..1.0), 9),
            data in prop::collection::vec(-1f64..3.0, 9),
            limits in prop::collection::vec((prop::array::uniform4(0f64..2.0), 0.05f64..1.0), 8),
        ) {
            let mut hessian = [0.0; SIZE * SIZE];
            let mut rhs = [0.0; SIZE];
            for (row, y) in rows.iter().zip(&data) {
                for i in 0..SIZE {
                    rhs[i] += row[i] * y;
                    for j in 0..SIZE {
                        hessian[SIZE * i + j] += row[i] * row[j];
                    }
                }
            }
            (0..SIZE).for_each(|i| hessian[i * (SIZE + 1)] += 1e-6);
            let padded = |row: [f64; SIZE]| std::array::from_fn(|i| if i < SIZE { row[i] } else { 0.0 });
            let mut inequalities: Vec<Inequality> =
                limits.iter().map(|&(row, most)| Inequality { row: padded(row), most }).collect();
            for i in 0..SIZE {
                let sign = std::array::from_fn(|k| if k == i { -1.0 } else { 0.0 });
                inequalities.push(Inequality { row: sign, most: 0.0 });
            }
            let found = minimise(&hessian, &rhs, &inequalities).unwrap();
            for limit in &inequalities {
                let value: f64 = (0..SIZE).map(|i| limit.row[i] * found.x[i]).sum();
                prop_assert!(value <= limit.most + 1e-8, "{value} {limit:?}");
            }
            let product = |i| (0..SIZE).map(|j| hessian[SIZE * i + j] * found.x[j]).sum::<f64>();
            let mut gradient: [f64; SIZE] = std::array::from_fn(|i| product(i) - rhs[i]);
            for (place, multiplier) in found.pressing() {
                let limit = inequalities[place];
                let value: f64 = (0..SIZE).map(|i| limit.row[i] * found.x[i]).sum();
                prop_assert!(multiplier >= -1e-9 && (value - limit.most).abs() < 1e-7, "{multiplier} \
                     {value}");
                (0..SIZE).for_each(|i| gradient[i] += multiplier * limit.row[i]);
            }
            prop_assert!(gradient.iter().all(|g| g.abs() < 1e-6), "{gradient:?}");
        }
    }

    #[test]
    fn inequalities_that_exclude_each_other_have_no_minimum() {
        let limit = |a: f64, most: f64| {
            let row = std::array::from_fn(|k| if k == 0 { a } else { 0.0 });
            Inequality { row, most }
        };
        assert!(minimise(&[1.0], &[0.0], &[limit(1.0, -1.0), limit(-1.0, 0.5)]).is_none());
        let near = |a: f64, b: f64| (a - b).abs() < 1e-12;
        assert!(near(minimise(&[2.0], &[6.0], &[limit(1.0, 5.0)]).unwrap().x[0], 3.0));
        let held = minimise(&[2.0], &[6.0], &[limit(1.0, 2.0)]).unwrap();
        assert!(
            near(held.x[0], 2.0)
                && held.pressing().all(|(place, multiplier)| place == 0 && near(multiplier, 2.0))
        );
        assert_eq!(held.count, 1);
    }
}
