//! Small dense systems: Cholesky for the normal equations and non-negative least squares by trying all sets
//! of unknowns.
//!
//! The systems have 2 to about 14 unknowns and are solved some millions of times, in buffers of the caller.

/// Solves A x = b for a symmetric positive definite matrix, given row by row, in place: `a` becomes its
/// Cholesky factor and `b` the solution. False where the matrix is not positive definite.
pub fn solve_spd(a: &mut [f64], b: &mut [f64]) -> bool {
    let regular = factor(a, b.len());
    if regular {
        substitute(a, b);
    }
    regular
}

/// Replaces the lower half of a symmetric matrix of `size` rows by its Cholesky factor; false where it is not
/// positive definite.
pub fn factor(a: &mut [f64], size: usize) -> bool {
    for i in 0..size {
        for j in 0..=i {
            let dot: f64 = (0..j).map(|k| a[i * size + k] * a[j * size + k]).sum();
            let rest = a[i * size + j] - dot;
            if i == j {
                if rest.is_nan() || rest <= 0.0 || !rest.is_finite() {
                    return false;
                }
                a[i * size + i] = rest.sqrt();
            } else {
                a[i * size + j] = rest / a[j * size + j];
            }
        }
    }
    true
}

/// Solves A x = b in place by the Cholesky factor of A.
pub fn substitute(a: &[f64], b: &mut [f64]) {
    let size = b.len();
    for i in 0..size {
        let dot: f64 = (0..i).map(|k| a[i * size + k] * b[k]).sum();
        b[i] = (b[i] - dot) / a[i * size + i];
    }
    for i in (0..size).rev() {
        let dot: f64 = (i + 1..size).map(|k| a[k * size + i] * b[k]).sum();
        b[i] = (b[i] - dot) / a[i * size + i];
    }
}

/// Solves A x = b for any regular matrix, given row by row, in place, by elimination with row exchanges;
/// false where it is singular.
pub fn solve(a: &mut [f64], b: &mut [f64]) -> bool {
    let size = b.len();
    let largest = a.iter().fold(0.0f64, |largest, x| largest.max(x.abs()));
    for column in 0..size {
        let pivot = (column..size)
            .max_by(|&i, &j| a[i * size + column].abs().total_cmp(&a[j * size + column].abs()))
            .unwrap_or(column);
        let value = a[pivot * size + column];
        if value.is_nan() || value.abs() <= 1e-14 * largest {
            return false;
        }
        if pivot != column {
            (0..size).for_each(|k| a.swap(pivot * size + k, column * size + k));
            b.swap(pivot, column);
        }
        for row in column + 1..size {
            let factor = a[row * size + column] / value;
            (column..size).for_each(|k| a[row * size + k] -= factor * a[column * size + k]);
            b[row] -= factor * b[column];
        }
    }
    for row in (0..size).rev() {
        let known: f64 = (row + 1..size).map(|k| a[row * size + k] * b[k]).sum();
        b[row] = (b[row] - known) / a[row * size + row];
    }
    true
}

/// Eigenvectors of a symmetric matrix of `size` rows, as columns of `vectors`, by Jacobi's rotations; `a`
/// keeps the eigenvalues on its diagonal.
pub fn eigen(a: &mut [f64], vectors: &mut [f64], size: usize) {
    for (k, entry) in vectors.iter_mut().enumerate() {
        *entry = f64::from(u8::from(k % (size + 1) == 0));
    }
    for _ in 0..50 {
        let square = |k: usize| a[k] * a[k];
        let beside: f64 = (0..size * size).filter(|k| k % (size + 1) != 0).map(square).sum();
        let whole: f64 = (0..size * size).map(square).sum();
        if beside <= 1e-28 * whole {
            return;
        }
        for (p, q) in (0..size).flat_map(|q| (0..q).map(move |p| (p, q))) {
            let off = a[p * size + q];
            if off == 0.0 {
                continue;
            }
            let theta = (a[q * size + q] - a[p * size + p]) / (2.0 * off);
            let tan = theta.signum() / (theta.abs() + theta.hypot(1.0));
            let cos = 1.0 / tan.hypot(1.0);
            let sin = tan * cos;
            let turn = |x: &mut f64, y: &mut f64| (*x, *y) = (cos * *x - sin * *y, sin * *x + cos * *y);
            for k in 0..size {
                let (mut x, mut y) = (a[k * size + p], a[k * size + q]);
                turn(&mut x, &mut y);
                (a[k * size + p], a[k * size + q]) = (x, y);
            }
            for k in 0..size {
                let (mut x, mut y) = (a[p * size + k], a[q * size + k]);
                turn(&mut x, &mut y);
                (a[p * size + k], a[q * size + k]) = (x, y);
                let (mut x, mut y) = (vectors[k * size + p], vectors[k * size + q]);
                turn(&mut x, &mut y);
                (vectors[k * size + p], vectors[k * size + q]) = (x, y);
            }
        }
    }
}

/// Most unknowns of [`nnls`]: ρ_d, four lobes, f0 and f90.
pub const MOST_UNKNOWNS: usize = 7;

/// Minimises xᵀ G x − 2 hᵀ x over x ≥ 0 (non-negative least squares by its normal equations). Returns hᵀ x,
/// the part of the squared data that is explained; `x` is 0 for unknowns at their bound. Up to
/// [`MOST_UNKNOWNS`] unknowns.
pub fn nnls(gram: &[f64], rhs: &[f64], x: &mut [f64]) -> f64 {
    let size = rhs.len();
    debug_assert!(size <= MOST_UNKNOWNS);
    let mut best = 0.0;
    x.fill(0.0);
    let all = (1usize << size) - 1;
    for set in (1..=all).rev() {
        let (mut a, mut b) = ([0.0; MOST_UNKNOWNS * MOST_UNKNOWNS], [0.0; MOST_UNKNOWNS]);
        let mut members = [0; MOST_UNKNOWNS];
        let mut count = 0;
        for i in (0..size).filter(|i| set >> i & 1 == 1) {
            members[count] = i;
            count += 1;
        }
        for i in 0..count {
            b[i] = rhs[members[i]];
            for j in 0..count {
                a[i * count + j] = gram[members[i] * size + members[j]];
            }
            a[i * count + i] *= 1.0 + 1e-12;
        }
        if !solve_spd(&mut a[..count * count], &mut b[..count]) || b[..count].iter().any(|&x| x < 0.0) {
            continue;
        }
        let explained: f64 = (0..count).map(|i| b[i] * rhs[members[i]]).sum();
        if explained > best {
            best = explained;
            x.fill(0.0);
            for i in 0..count {
                x[members[i]] = b[i];
            }
        }
        if set == all {
            // The unconstrained minimum is feasible: no subset does better.
            break;
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_known_system_is_solved_and_an_indefinite_one_refused() {
        let mut a = [4.0, 2.0, 2.0, 3.0];
        let mut b = [10.0, 8.0];
        assert!(solve_spd(&mut a, &mut b));
        assert!((b[0] - 1.75).abs() < 1e-12 && (b[1] - 1.5).abs() < 1e-12);
        assert!(!solve_spd(&mut [1.0, 2.0, 2.0, 1.0], &mut [1.0, 1.0]));
        assert!(!solve_spd(&mut [f64::NAN], &mut [1.0]));
    }

    proptest! {
        #[test]
        fn any_regular_system_is_solved(
            entries in prop::collection::vec(-1f64..1.0, 16),
            x in prop::array::uniform4(-1f64..1.0),
        ) {
            let mut b: [f64; 4] = std::array::from_fn(|i| (0..4).map(|j| entries[4 * i + j] * x[j]).sum());
            let mut a = entries.clone();
            if solve(&mut a, &mut b) {
                for i in 0..4 {
                    let value: f64 = (0..4).map(|j| entries[4 * i + j] * b[j]).sum();
                    let expected: f64 = (0..4).map(|j| entries[4 * i + j] * x[j]).sum();
                    let largest = b.iter().fold(0.0f64, |m, b| m.max(b.abs()));
                    prop_assert!((value - expected).abs() < 1e-8 * (1.0 + largest));
                }
            }
        }

        #[test]
        fn eigenvectors_are_orthogonal_and_turn_the_matrix_into_its_eigenvalues(
            entries in prop::collection::vec(-1f64..1.0, 15),
        ) {
            const SIZE: usize = 5;
            let entry = |i: usize, j: usize| entries[i.max(j) * (i.max(j) + 1) / 2 + i.min(j)];
            let (mut a, mut v) = ([0.0; SIZE * SIZE], [0.0; SIZE * SIZE]);
            (0..SIZE * SIZE).for_each(|k| a[k] = entry(k / SIZE, k % SIZE));
            eigen(&mut a, &mut v, SIZE);
            for i in 0..SIZE {
                for j in 0..SIZE {
                    let along = |row: &dyn Fn(usize) -> f64| -> f64 {
                        (0..SIZE).map(|k| row(k) * v[k * SIZE + j]).sum()
                    };
                    let product = along(&|k| entry(i, k));
                    prop_assert!((product - a[j * (SIZE + 1)] * v[i * SIZE + j]).abs() < 1e-9);
                    let dot = along(&|k| v[k * SIZE + i]);
                    prop_assert!((dot - f64::from(u8::from(i == j))).abs() < 1e-9);
                }
            }
        }

        #[test]
        fn non_negative_least_squares_meets_the_optimality_conditions(
            rows in prop::collection::vec(prop::array::uniform4(-1f64..1.0), 8),
            data in prop::collection::vec(-1f64..1.0, 8),
        ) {
            let mut gram = [0.0; 16];
            let mut rhs = [0.0; 4];
            for (row, y) in rows.iter().zip(&data) {
                for i in 0..4 {
                    rhs[i] += row[i] * y;
                    for j in 0..4 {
                        gram[4 * i + j] += row[i] * row[j];
                    }
                }
            }
            let mut x = [0.0; 4];
            nnls(&gram, &rhs, &mut x);
            for i in 0..4 {
                let gradient = (0..4).map(|j| gram[4 * i + j] * x[j]).sum::<f64>() - rhs[i];
                prop_assert!(x[i] >= 0.0);
                prop_assert!(if x[i] > 0.0 { gradient.abs() < 1e-6 } else { gradient > -1e-6 }, "{i} \
                     {gradient} {x:?}");
            }
        }
    }
}
