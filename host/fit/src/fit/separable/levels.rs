//! A ρ_d a texel where texels are fitted together: it follows in closed form, as the weighted mean that the
//! lobes leave of the texel, and so is no unknown of the search.
//!
//! With D the columns of those ρ_d, least squares over D and the other columns X have the same solution in X
//! as least squares over (I − H_D) X against (I − H_D) y (Frisch and Waugh 1933). H_D takes the weighted mean
//! within each texel, and since it does not depend on the shapes the derivatives of the columns are treated
//! alike.

/// Takes from a column, which is values times the roots of their weights, the weighted mean within every
/// texel. `starts` says where the texels begin and where the last ends.
#[inline(always)]
pub fn take_off(starts: &[usize], root: &[f64], column: &mut [f64]) {
    for ends in starts.windows(2) {
        let (root, column) = (&root[ends[0]..ends[1]], &mut column[ends[0]..ends[1]]);
        let (mut product, mut square) = (0.0, 0.0);
        for (root, value) in root.iter().zip(column.iter()) {
            product += root * value;
            square += root * root;
        }
        let mean = if square > 0.0 { product / square } else { 0.0 };
        for (root, value) in root.iter().zip(column) {
            *value -= mean * root;
        }
    }
}

/// The diagonal of H_D: the share that each sample has in the ρ_d of its texel. Empty without texels.
pub fn shares(starts: &[usize], root: &[f64]) -> Vec<f64> {
    let mut shares = vec![0.0; if starts.is_empty() { 0 } else { root.len() }];
    for ends in starts.windows(2) {
        let square: f64 = root[ends[0]..ends[1]].iter().map(|root| root * root).sum();
        for k in ends[0]..ends[1] {
            shares[k] = if square > 0.0 { root[k] * root[k] / square } else { 0.0 };
        }
    }
    shares
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_is_orthogonal_to_every_texel_s_level_and_a_level_leaves_nothing() {
        let starts = [0, 3, 4, 8];
        let root = [1.0, 2.0, 0.5, 3.0, 1.0, 0.0, 2.0, 1.5];
        let mut column = [0.3, -1.0, 2.0, 5.0, 0.2, 0.0, 0.7, -0.4];
        take_off(&starts, &root, &mut column);
        for ends in starts.windows(2) {
            let product: f64 = (ends[0]..ends[1]).map(|k| root[k] * column[k]).sum();
            assert!(product.abs() < 1e-14, "{product}");
        }
        // A texel of one sample says nothing of the rest.
        assert!(column[3].abs() < 1e-14);
        let mut level: Vec<f64> = root.iter().map(|root| 0.7 * root).collect();
        take_off(&starts, &root, &mut level);
        assert!(level.iter().all(|value| value.abs() < 1e-14), "{level:?}");
        let shares = shares(&starts, &root);
        let sums = starts.windows(2).map(|ends| shares[ends[0]..ends[1]].iter().sum::<f64>());
        assert!(sums.into_iter().all(|sum| (sum - 1.0).abs() < 1e-14) && shares[3] == 1.0);
    }
}
