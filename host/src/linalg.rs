//! Small dense least squares: normal equations solved by Cholesky's factorisation, for a handful of unknowns.

/// Normal equations AᵀA x = Aᵀb, gathered row by row.
#[derive(Debug, Clone)]
pub struct NormalEquations<const N: usize> {
    matrix: [[f64; N]; N],
    right: [f64; N],
}

impl<const N: usize> Default for NormalEquations<N> {
    fn default() -> Self {
        Self { matrix: [[0.0; N]; N], right: [0.0; N] }
    }
}

impl<const N: usize> NormalEquations<N> {
    /// Adds one equation row · x = value.
    pub fn add(&mut self, row: &[f64; N], value: f64) {
        for i in 0..N {
            for j in 0..=i {
                self.matrix[i][j] += row[i] * row[j];
            }
            self.right[i] += row[i] * value;
        }
    }

    /// The least-squares solution, or `None` when the equations do not determine it.
    pub fn solve(&self) -> Option<[f64; N]> {
        let factor = self.factor()?;
        let mut x = self.right;
        for i in 0..N {
            for j in 0..i {
                x[i] -= factor[i][j] * x[j];
            }
            x[i] /= factor[i][i];
        }
        for i in (0..N).rev() {
            for j in i + 1..N {
                x[i] -= factor[j][i] * x[j];
            }
            x[i] /= factor[i][i];
        }
        Some(x)
    }

    /// The lower Cholesky factor.
    fn factor(&self) -> Option<[[f64; N]; N]> {
        let mut factor = self.matrix;
        for i in 0..N {
            for j in 0..=i {
                let sum: f64 = (0..j).map(|k| factor[i][k] * factor[j][k]).sum();
                if i == j {
                    let pivot = factor[i][i] - sum;
                    // Relative to the diagonal, so that the test does not depend on units.
                    if pivot.partial_cmp(&(1e-14 * self.matrix[i][i])) != Some(std::cmp::Ordering::Greater) {
                        return None;
                    }
                    factor[i][i] = pivot.sqrt();
                } else {
                    factor[i][j] = (factor[i][j] - sum) / factor[j][j];
                }
            }
        }
        Some(factor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_through_exact_points_is_found() {
        let mut equations = NormalEquations::<2>::default();
        for x in [0.0, 1.0, 2.0, 5.0] {
            equations.add(&[x, 1.0], 3.0 * x - 2.0);
        }
        let [slope, offset] = equations.solve().unwrap();
        assert!((slope - 3.0).abs() < 1e-12 && (offset + 2.0).abs() < 1e-12);
    }

    #[test]
    fn undetermined_equations_have_no_solution() {
        let mut equations = NormalEquations::<2>::default();
        equations.add(&[1.0, 2.0], 1.0);
        equations.add(&[2.0, 4.0], 2.0);
        assert!(equations.solve().is_none());
    }
}
