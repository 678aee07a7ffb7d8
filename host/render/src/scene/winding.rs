//! Winding: files whose triangles do not all run the same way round would get normals that cancel.

use std::collections::HashMap;

/// Which triangles must be turned so that neighbours agree: across an edge of exactly two triangles the edge
/// runs both ways. In every connected part the smaller number of triangles is turned; parts that agree stay
/// as they are.
pub(super) fn to_turn(triangles: &[[u32; 3]]) -> Vec<bool> {
    let mut to_turn = vec![false; triangles.len()];
    let neighbours = neighbours(triangles);
    // Whether a triangle runs against the first of its part; `None` before it is reached.
    let mut against: Vec<Option<bool>> = vec![None; triangles.len()];
    let mut part = Vec::new();
    for start in 0..triangles.len() {
        if against[start].is_some() {
            continue;
        }
        against[start] = Some(false);
        part.clear();
        part.push(start);
        let mut reached = 0;
        while reached < part.len() {
            let (triangle, turned) = (part[reached], against[part[reached]] == Some(true));
            reached += 1;
            for &(next, agrees) in neighbours[triangle].iter().flatten() {
                if against[next as usize].is_none() {
                    against[next as usize] = Some(turned == agrees);
                    part.push(next as usize);
                }
            }
        }
        let turned = part.iter().filter(|&&t| against[t] == Some(true)).count();
        let majority_is_against = 2 * turned > part.len();
        for &t in part.iter().filter(|&&t| against[t] != Some(majority_is_against)) {
            to_turn[t] = true;
        }
    }
    to_turn
}

/// For each edge of every triangle, the triangle beyond it and whether that one runs the same way round.
fn neighbours(triangles: &[[u32; 3]]) -> Vec<[Option<(u32, bool)>; 3]> {
    let edge = |t: usize, k: usize| (triangles[t][k], triangles[t][(k + 1) % 3]);
    let mut users: HashMap<(u32, u32), Vec<(usize, usize)>> = HashMap::new();
    for t in 0..triangles.len() {
        for k in 0..3 {
            let (a, b) = edge(t, k);
            users.entry((a.min(b), a.max(b))).or_default().push((t, k));
        }
    }
    let mut found = vec![[None; 3]; triangles.len()];
    for pair in users.values() {
        if let &[(s, i), (t, k)] = pair.as_slice() {
            let agrees = edge(s, i) != edge(t, k);
            found[s][i] = Some((t as u32, agrees));
            found[t][k] = Some((s as u32, agrees));
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::shapes;

    #[test]
    fn turned_triangles_are_turned_back_and_good_meshes_stay() {
        let sphere = shapes::sphere(24, 12);
        assert!(!to_turn(&sphere.triangles).contains(&true));
        let mut broken = sphere.triangles.clone();
        for triangle in broken.iter_mut().step_by(3) {
            triangle.swap(1, 2);
        }
        let turned = to_turn(&broken);
        broken.iter_mut().zip(turned).filter(|(_, turn)| *turn).for_each(|(triangle, _)| triangle.swap(1, 2));
        let canonical = |t: &[u32; 3]| {
            let k = (0..3).min_by_key(|&k| t[k]).unwrap();
            [t[k], t[(k + 1) % 3], t[(k + 2) % 3]]
        };
        assert!(broken.iter().map(canonical).eq(sphere.triangles.iter().map(canonical)));
    }
}
