//! Everything that shines from a surface, sampled by power and place: a tree of triangles and rectangles by
//! box, cone of normals and power, descended by what each half can send to a point at most (Conty Estevez and
//! Kulla 2018, "Importance sampling of many lights with adaptive tree splitting").

use std::f32::consts::{FRAC_PI_2, PI};

use glam::Vec3;

use super::rectangle::Rectangle;
use super::triangle::Triangle;
use lobelia_reflectance::{Rgb, colour};

/// Buckets a split is looked for among.
const BUCKETS: usize = 12;

/// What shines.
pub(super) enum Shape {
    /// A rectangular light and its radiance.
    Rectangle(Rectangle, Rgb),
    /// A triangle of a mesh, by its index in the geometry.
    Triangle(Triangle, u32),
}

/// A leaf's shape with the place that it takes.
pub(super) struct Emitter {
    pub(super) shape: Shape,
    bounds: Bounds,
    leaf: u32,
}

/// What is known of some emitters together.
#[derive(Debug, Clone, Copy)]
struct Bounds {
    low: Vec3,
    high: Vec3,
    /// Middle of the cone of their normals, and its half angle's cosine and sine.
    axis: Vec3,
    cone: [f32; 2],
    /// Area times luminance.
    power: f32,
}

#[derive(Debug, Clone, Copy)]
struct Node {
    bounds: Bounds,
    parent: u32,
    /// The first of two children, which follow each other, or an emitter.
    first: u32,
    leaf: bool,
}

/// A scene's emitters.
#[derive(Default)]
pub(super) struct Emitters {
    nodes: Vec<Node>,
    pub(super) emitters: Vec<Emitter>,
}

/// Places on one emitter, drawn from a point.
pub(super) struct Chosen {
    pub(super) emitter: u32,
    /// Probability of the choice.
    pub(super) probability: f32,
    /// What is left of the number that chose, again in 0..1.
    pub(super) rest: f32,
}

impl Emitter {
    /// A rectangle of a radiance.
    pub(super) fn rectangle(rectangle: Rectangle, [centre, u, v]: [Vec3; 3], radiance: Rgb) -> Self {
        let half = (u.abs() + v.abs()) / 2.0;
        let area = u.cross(v);
        let bounds = Bounds {
            low: centre - half,
            high: centre + half,
            axis: area.normalize(),
            cone: [1.0, 0.0],
            power: area.length() * weight(radiance),
        };
        Self { shape: Shape::Rectangle(rectangle, radiance), bounds, leaf: 0 }
    }

    /// A triangle of a mean radiance; none where it has no area.
    pub(super) fn triangle(corners: [Vec3; 3], index: u32, radiance: Rgb) -> Option<Self> {
        let triangle = Triangle::new(corners)?;
        let [a, b, c] = corners;
        let bounds = Bounds {
            low: a.min(b).min(c),
            high: a.max(b).max(c),
            axis: triangle.normal,
            cone: [1.0, 0.0],
            power: triangle.area * weight(radiance),
        };
        Some(Self { shape: Shape::Triangle(triangle, index), bounds, leaf: 0 })
    }
}

/// What a radiance counts: the largest channel too, since a saturated blue has little luminance.
fn weight(radiance: Rgb) -> f32 {
    0.9 * colour::luminance(radiance) + 0.1 * radiance.max_element()
}

impl Bounds {
    fn joined(&self, other: &Self) -> Self {
        let (axis, cone) = joined_cones((self.axis, self.cone), (other.axis, other.cone));
        Self {
            low: self.low.min(other.low),
            high: self.high.max(other.high),
            axis,
            cone,
            power: self.power + other.power,
        }
    }

    /// What a half costs in the choice of a split: power times the solid angle that its light takes times the
    /// box's area.
    fn cost(&self) -> f32 {
        let size = self.high - self.low;
        let area = size.x * size.y + size.y * size.z + size.z * size.x;
        let angle = self.cone[1].atan2(self.cone[0]);
        let end = (angle + FRAC_PI_2).min(PI);
        let rest =
            2.0 * end * self.cone[1] - (angle - 2.0 * end).cos() - 2.0 * angle * self.cone[1] + self.cone[0];
        let solid = 2.0 * PI * (1.0 - self.cone[0]) + FRAC_PI_2 * rest;
        self.power * solid * area
    }

    /// About the irradiance at a point of a surface at most.
    fn importance(&self, point: Vec3, normal: Vec3) -> f32 {
        let to = 0.5 * (self.low + self.high) - point;
        let radius2 = 0.25 * (self.high - self.low).length_squared();
        let distance2 = to.length_squared();
        let (mut at_emitter, mut at_point) = (1.0, 1.0);
        if distance2 > radius2 {
            let toward = to / distance2.sqrt();
            let sine2 = radius2 / distance2;
            let ball = [(1.0 - sine2).sqrt(), sine2.sqrt()];
            let out = -toward.dot(self.axis);
            at_emitter = nearer(nearer_pair(out, self.cone), ball);
            at_point = nearer(with_sine(toward.dot(normal)), ball);
        }
        self.power * at_emitter.max(0.0) * at_point.max(0.0) / distance2.max(radius2).max(f32::MIN_POSITIVE)
    }
}

/// A cosine with its sine.
fn with_sine(cosine: f32) -> [f32; 2] {
    [cosine, (1.0 - cosine * cosine).max(0.0).sqrt()]
}

/// Cosine and sine of an angle less another, not below 0.
fn nearer_pair(cosine: f32, less: [f32; 2]) -> [f32; 2] {
    if cosine >= less[0] {
        return [1.0, 0.0];
    }
    let [_, sine] = with_sine(cosine);
    [cosine * less[0] + sine * less[1], sine * less[0] - cosine * less[1]]
}

/// The cosine of an angle less another, 1 where it is the smaller one.
fn nearer([cosine, sine]: [f32; 2], less: [f32; 2]) -> f32 {
    if cosine >= less[0] { 1.0 } else { cosine * less[0] + sine * less[1] }
}

/// The least cone about two.
fn joined_cones(a: (Vec3, [f32; 2]), b: (Vec3, [f32; 2])) -> (Vec3, [f32; 2]) {
    let angle = |[cos, sin]: [f32; 2]| sin.atan2(cos);
    let (wide, narrow) = if angle(a.1) >= angle(b.1) { (a, b) } else { (b, a) };
    let between = wide.0.angle_between(narrow.0);
    let (wide_angle, narrow_angle) = (angle(wide.1), angle(narrow.1));
    if (between + narrow_angle).min(PI) <= wide_angle {
        return wide;
    }
    let joined = 0.5 * (wide_angle + between + narrow_angle);
    let across = wide.0.cross(narrow.0).try_normalize();
    let Some(across) = across.filter(|_| joined < PI) else { return (wide.0, [-1.0, 0.0]) };
    let axis = glam::Quat::from_axis_angle(across, joined - wide_angle) * wide.0;
    let (sin, cos) = joined.sin_cos();
    (axis.normalize(), [cos, sin])
}

impl Emitters {
    /// Builds the tree; what has no power is left out.
    pub(super) fn new(mut emitters: Vec<Emitter>) -> Self {
        emitters.retain(|emitter| emitter.bounds.power > 0.0);
        let mut built = Self { nodes: Vec::with_capacity(2 * emitters.len()), emitters };
        let Some(all) = built.emitters.iter().map(|emitter| emitter.bounds).reduce(|a, b| a.joined(&b))
        else {
            return built;
        };
        built.nodes.push(Node { bounds: all, parent: 0, first: 0, leaf: false });
        let mut order: Vec<u32> = (0..built.emitters.len() as u32).collect();
        built.divide(0, &mut order);
        built
    }

    /// The same emitters chosen by their power alone: in boxes without bounds every point is in the middle of
    /// all.
    #[cfg(test)]
    pub(super) fn by_power(mut self) -> Self {
        for node in &mut self.nodes {
            (node.bounds.low, node.bounds.high) = (Vec3::splat(-1e6), Vec3::splat(1e6));
        }
        self
    }

    fn divide(&mut self, node: u32, order: &mut [u32]) {
        if let [one] = *order {
            let place = &mut self.nodes[node as usize];
            (place.first, place.leaf) = (one, true);
            self.emitters[one as usize].leaf = node;
            return;
        }
        let bounds = |order: &[u32], emitters: &[Emitter]| {
            order.iter().map(|&k| emitters[k as usize].bounds).reduce(|a, b| a.joined(&b))
        };
        let middle = self.split(order);
        let (left, right) = order.split_at_mut(middle);
        let halves = [bounds(left, &self.emitters), bounds(right, &self.emitters)];
        let first = self.nodes.len() as u32;
        self.nodes[node as usize].first = first;
        for half in halves.into_iter().flatten() {
            self.nodes.push(Node { bounds: half, parent: node, first: 0, leaf: false });
        }
        self.divide(first, left);
        self.divide(first + 1, right);
    }

    /// Sorts some emitters into two halves; how many are in the first.
    fn split(&self, order: &mut [u32]) -> usize {
        let centre = |k: u32| {
            let Bounds { low, high, .. } = self.emitters[k as usize].bounds;
            0.5 * (low + high)
        };
        let start = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        let (low, high) =
            order.iter().fold(start, |(low, high), &k| (low.min(centre(k)), high.max(centre(k))));
        let mut best: Option<(f32, usize, usize)> = None;
        for axis in 0..3 {
            let extent = high[axis] - low[axis];
            if extent <= 0.0 {
                continue;
            }
            let mut buckets: [Option<Bounds>; BUCKETS] = [None; BUCKETS];
            for &k in order.iter() {
                let bucket = &mut buckets[bucket(centre(k)[axis], low[axis], extent)];
                let own = self.emitters[k as usize].bounds;
                *bucket = Some(bucket.map_or(own, |bounds| bounds.joined(&own)));
            }
            for after in 1..BUCKETS {
                let join = |part: &[Option<Bounds>]| {
                    part.iter().flatten().copied().reduce(|a, b| a.joined(&b)).map(|bounds| bounds.cost())
                };
                let (Some(a), Some(b)) = (join(&buckets[..after]), join(&buckets[after..])) else { continue };
                if best.is_none_or(|(cost, ..)| a + b < cost) {
                    best = Some((a + b, axis, after));
                }
            }
        }
        let Some((_, axis, after)) = best else { return order.len() / 2 };
        order.sort_by(|&a, &b| centre(a)[axis].total_cmp(&centre(b)[axis]).then(a.cmp(&b)));
        order.partition_point(|&k| bucket(centre(k)[axis], low[axis], high[axis] - low[axis]) < after)
    }

    /// Chooses an emitter for a point of a surface by a number in 0..1; none where nothing can reach it.
    pub(super) fn choose(&self, point: Vec3, normal: Vec3, mut number: f32) -> Option<Chosen> {
        let mut node = self.nodes.first()?;
        let mut probability = 1.0;
        while !node.leaf {
            let share = self.share(node.first, point, normal)?;
            if number < share {
                (number, probability) = (number / share, probability * share);
                node = &self.nodes[node.first as usize];
            } else {
                (number, probability) = ((number - share) / (1.0 - share), probability * (1.0 - share));
                node = &self.nodes[node.first as usize + 1];
            }
        }
        Some(Chosen { emitter: node.first, probability, rest: number.min(1.0f32.next_down()) })
    }

    /// The part that the first of two children has; none where neither can send anything.
    fn share(&self, first: u32, point: Vec3, normal: Vec3) -> Option<f32> {
        let [a, b] = [first, first + 1].map(|k| self.nodes[k as usize].bounds.importance(point, normal));
        let sum = a + b;
        (sum > 0.0 && sum.is_finite()).then(|| a / sum)
    }

    /// The probability with which an emitter is chosen for a point.
    pub(super) fn probability(&self, emitter: u32, point: Vec3, normal: Vec3) -> f32 {
        let mut probability = 1.0;
        let mut place = self.emitters[emitter as usize].leaf;
        while place != 0 {
            let parent = self.nodes[place as usize].parent;
            let first = self.nodes[parent as usize].first;
            let Some(share) = self.share(first, point, normal) else { return 0.0 };
            probability *= if place == first { share } else { 1.0 - share };
            place = parent;
        }
        probability
    }

    /// The offset from a point to a place on an emitter by two numbers, and the density of its direction over
    /// that emitter.
    pub(super) fn sample(&self, emitter: u32, point: Vec3, numbers: [f32; 2]) -> Option<(Vec3, f32)> {
        match &self.emitters[emitter as usize].shape {
            Shape::Rectangle(rectangle, _) => {
                let seen = rectangle.seen(point)?;
                Some((seen.sample(numbers), 1.0 / seen.solid_angle()))
            }
            Shape::Triangle(triangle, _) => {
                let seen = triangle.seen(point)?;
                let to = seen.sample(numbers);
                Some((to, seen.density(to)))
            }
        }
    }

    /// The density, sr⁻¹, with which a direction to a place on an emitter is drawn; none where it never is.
    pub(super) fn density(&self, emitter: u32, point: Vec3, normal: Vec3, to: Vec3) -> Option<f32> {
        let alone = match &self.emitters[emitter as usize].shape {
            Shape::Rectangle(rectangle, _) => 1.0 / rectangle.seen(point)?.solid_angle(),
            Shape::Triangle(triangle, _) => triangle.seen(point)?.density(to),
        };
        Some(alone * self.probability(emitter, point, normal))
    }

    /// Bytes held.
    pub(super) fn bytes(&self) -> usize {
        size_of_val(&self.nodes[..]) + size_of_val(&self.emitters[..])
    }
}

/// The bucket of a coordinate.
fn bucket(at: f32, low: f32, extent: f32) -> usize {
    (((at - low) / extent * BUCKETS as f32) as usize).min(BUCKETS - 1)
}
