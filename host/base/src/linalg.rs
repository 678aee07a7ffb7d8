//! Small dense least squares: normal equations gathered row by row and solved by Cholesky's method.

/// The normal equations JᵀWJ x = JᵀWr of N unknowns; only the lower triangle is kept.
#[derive(Debug, Clone)]
pub struct Normal<const N: usize> {
    matrix: [[f64; N]; N],
    right: [f64; N],
}

impl<const N: usize> Default for Normal<N> {
    fn default() -> Self {
        Self { matrix: [[0.0; N]; N], right: [0.0; N] }
    }
}

impl<const N: usize> Normal<N> {
    /// No equations yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds an equation `row · x = residual` with a weight.
    pub fn add(&mut self, row: &[f64; N], residual: f64, weight: f64) {
        for i in 0..N {
            let scaled = row[i] * weight;
            self.right[i] += scaled * residual;
            for (sum, other) in self.matrix[i][..=i].iter_mut().zip(row) {
                *sum += scaled * other;
            }
        }
    }

    /// The solution with the diagonal enlarged by a factor 1 + damping (Marquardt), if the equations
    /// determine it.
    pub fn solve(&self, damping: f64) -> Option<[f64; N]> {
        Some(substitute(&self.factor(damping)?, self.right))
    }

    /// The diagonal of the inverse: the variances of the unknowns for residuals of unit variance.
    pub fn variances(&self) -> Option<[f64; N]> {
        let inverse = self.inverse()?;
        Some(std::array::from_fn(|i| inverse[i][i]))
    }

    /// The inverse: the covariance of the unknowns for residuals of unit variance.
    pub fn inverse(&self) -> Option<[[f64; N]; N]> {
        let factor = self.factor(0.0)?;
        Some(std::array::from_fn(|i| {
            let mut unit = [0.0; N];
            unit[i] = 1.0;
            substitute(&factor, unit)
        }))
    }

    /// The lower Cholesky factor.
    fn factor(&self, damping: f64) -> Option<[[f64; N]; N]> {
        let mut lower = [[0.0; N]; N];
        for i in 0..N {
            for j in 0..=i {
                let known: f64 = (0..j).map(|k| lower[i][k] * lower[j][k]).sum();
                let diagonal = self.matrix[i][i] * (1.0 + damping);
                lower[i][j] = if i != j {
                    (self.matrix[i][j] - known) / lower[j][j]
                } else if diagonal - known > 1e-12 * diagonal {
                    (diagonal - known).sqrt()
                } else {
                    return None;
                };
            }
        }
        Some(lower)
    }
}

/// Solves L Lᵀ x = b.
fn substitute<const N: usize>(lower: &[[f64; N]; N], mut b: [f64; N]) -> [f64; N] {
    for i in 0..N {
        let known: f64 = (0..i).map(|k| lower[i][k] * b[k]).sum();
        b[i] = (b[i] - known) / lower[i][i];
    }
    for i in (0..N).rev() {
        let known: f64 = (i + 1..N).map(|k| lower[k][i] * b[k]).sum();
        b[i] = (b[i] - known) / lower[i][i];
    }
    b
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plane_is_recovered_from_its_points() {
        let mut normal = Normal::new();
        for i in 0..30 {
            let (x, y) = (f64::from(i % 7), f64::from(i % 5));
            normal.add(&[1.0, x, y], 3.0 - 2.0 * x + 0.5 * y, 1.0 + x);
        }
        let plane = normal.solve(0.0).unwrap();
        for (found, expected) in plane.iter().zip([3.0, -2.0, 0.5]) {
            assert!((found - expected).abs() < 1e-12);
        }
    }

    #[test]
    fn the_variance_of_a_mean_is_one_over_the_count() {
        let mut normal = Normal::new();
        (0..16).for_each(|_| normal.add(&[1.0], 0.0, 1.0));
        assert_eq!(normal.variances(), Some([1.0 / 16.0]));
    }

    #[test]
    fn undetermined_unknowns_have_no_solution() {
        let mut normal = Normal::new();
        normal.add(&[1.0, 1.0], 1.0, 1.0);
        assert_eq!(normal.solve(0.0), None);
    }
}
