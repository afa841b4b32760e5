//! Finds values that occur more often than noise allows, in a sample of stretches of successive points.
//!
//! Two criteria, each with a probability of error below [`CHANCE_MAX`] per scan:
//! - The same (x, y, z) twice within a stretch, because a sensor does not measure one position twice in succession. The rate is
//!   compared with that of the other points of the scan, since points repeat in clouds on a coarse lattice.
//! - A z with more of the points around it than noise of the scan's own standard deviation puts into one step of the lattice of
//!   values, on any surface. If the noise does not exceed the lattice (or there is none, as in simulated scans), a horizontal
//!   surface has one z as well; a value is then missing data only if single points jump to it and back, or if it lies beyond the
//!   depth of any sensor of that width.
//!
//! Values of x or y alone are not a criterion, because rasters repeat them.

use crate::scan::cloud::Cloud;
use libm::erf;
use std::collections::HashMap;
use std::f64::consts::LN_2;

/// The pattern of the points to remove.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Pattern {
    /// A declared value in x, y or z, in the unit of the file.
    Any(f64),
    /// All coordinates of a point, mm.
    Point {
        /// y.
        y: f64,
        /// z.
        z: f64,
    },
    /// A z, mm.
    Z(f64),
}

/// Probability for each criterion that a missing value is reported for a scan without any.
const CHANCE_MAX: f64 = 1e-9;
/// Successive points of a stretch: enough for differences along the profile, few enough to stay within one.
const STRETCH: usize = 16;
/// Largest number of stretches in a sample. With 16 384 points a value of 1/500 occurs 33 times, which at [`CHANCE_MAX`] cannot be
/// noise of a scan that is finer than its lattice.
const STRETCHES_MAX: usize = 1024;
/// Least share of the points of a value that is examined.
const SHARE_MIN: f64 = 1.0 / 500.0;
/// Number of most frequent values that are excluded from the estimate of the noise: a file has one code or two, a horizontal
/// surface some values.
const LEFT_OUT_MAX: usize = 8;
/// Largest number of complete points that a file uses as codes.
const CODES_MAX: usize = 4;
/// The factor by which the noise of an adjacent surface may be smaller than that of the part.
const QUIETER: f64 = 4.0;
/// Largest depth of a sensor's range, in widths; no laser scanner reaches it, since triangulation is about as deep as wide.
const DEPTHS_MAX: f64 = 10.0;

/// The values of the cloud that are missing data.
pub(super) fn find(cloud: &Cloud) -> Vec<Pattern> {
    let mut sample = Sample::draw(cloud);
    let points = repeated_points(&sample);
    sample.drop_points(&points);
    let mut patterns: Vec<Pattern> = points.into_iter().map(|[y, z]| Pattern::Point { y, z }).collect();
    patterns.extend(repeated_heights(&sample));
    patterns
}

/// The largest share of a horizontal surface's points that noise can put into one exact value of z; 1 if noise is absent or cannot
/// be distinguished from the shape.
pub(super) fn most_of_one_value(cloud: &Cloud) -> f64 {
    let sample = Sample::draw(cloud);
    Noise::of(&sample, &candidates(&counts(&sample))).most_of_one_value()
}

/// Points of a cloud in stretches of successive ones.
struct Sample {
    stretches: Vec<Vec<[f64; 3]>>,
}

impl Sample {
    /// All points of a small cloud, otherwise stretches at even positions, each shifted at random within its share, so that the
    /// sample does not coincide with a period of the file.
    fn draw(cloud: &Cloud) -> Self {
        let count = cloud.columns.len();
        let starts: Vec<usize> = if count <= STRETCH * STRETCHES_MAX {
            (0..count).step_by(STRETCH).collect()
        } else {
            let share = count / STRETCHES_MAX;
            (0..STRETCHES_MAX).map(|k| k * share + scramble(k as u64) as usize % (share - STRETCH + 1)).collect()
        };
        let stretches = starts.into_iter().map(|start| stretch(cloud, start)).collect();
        Self { stretches }
    }

    fn points(&self) -> impl Iterator<Item = [f64; 3]> + '_ {
        self.stretches.iter().flatten().copied()
    }

    fn len(&self) -> usize {
        self.stretches.iter().map(Vec::len).sum()
    }

    fn drop_points(&mut self, points: &[[f64; 2]]) {
        if !points.is_empty() {
            self.stretches.iter_mut().for_each(|stretch| stretch.retain(|[_, y, z]| !points.contains(&[*y, *z])));
        }
    }
}

fn stretch(cloud: &Cloud, start: usize) -> Vec<[f64; 3]> {
    let mut stripes = cloud.stripes.iter().skip(cloud.stripes.partition_point(|stripe| stripe.end <= start)).peekable();
    let mut points = Vec::with_capacity(STRETCH);
    for index in start..start + STRETCH {
        while stripes.next_if(|stripe| stripe.end <= index).is_some() {}
        if let (Some(stripe), Some([y, z])) = (stripes.peek(), cloud.columns.get(index)) {
            points.push([stripe.x, y, z]);
        }
    }
    points
}

/// A fixed pseudo-random number of 64 bits (the finaliser of SplitMix64).
fn scramble(value: u64) -> u64 {
    let value = value.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let value = (value ^ (value >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let value = (value ^ (value >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    value ^ (value >> 31)
}

/// Maps −0 and 0 to one key.
fn key(value: f64) -> u64 {
    (value + 0.0).to_bits()
}

/// −ln of an upper bound of the probability that a statement about one of `values` is wrong.
fn evidence_needed(values: usize) -> f64 {
    (values.max(1) as f64 / CHANCE_MAX).ln()
}

/// (y, z) of the points that recur within a stretch more often than any other.
fn repeated_points(sample: &Sample) -> Vec<[f64; 2]> {
    let mut repeats: HashMap<[u64; 2], ([f64; 2], u64)> = HashMap::new();
    for stretch in &sample.stretches {
        for (index, point) in stretch.iter().enumerate() {
            if stretch.iter().take(index).any(|before| before == point) {
                let [_, y, z] = *point;
                repeats.entry([key(y), key(z)]).or_insert(([y, z], 0)).1 += 1;
            }
        }
    }
    let mut repeats: Vec<([f64; 2], u64)> = repeats.into_values().collect();
    repeats.sort_unstable_by(|(p, a), (q, b)| b.cmp(a).then(p.partial_cmp(q).unwrap_or(std::cmp::Ordering::Equal)));
    // The codes end where the next point recurs at a clearly lower rate.
    let needed = evidence_needed(sample.len());
    let ends = |count: usize| {
        let last = count.checked_sub(1).and_then(|last| repeats.get(last)).map_or(0, |(_, n)| *n);
        let next = repeats.get(count).map_or(0, |(_, n)| *n);
        poisson_evidence(last as f64, next as f64 + 1.0) > needed
    };
    let count = (1..=CODES_MAX).rev().find(|count| ends(*count)).unwrap_or(0);
    repeats.truncate(count);
    if !repeats.is_empty() {
        // If points lie closer than the step of their lattice, their neighbours do as well, while a code is isolated.
        let steps = sample.stretches.iter().flat_map(|stretch| stretch.windows(2)).filter_map(|pair| {
            let (&[_, y, z], &[_, next_y, next_z]) = (pair.first()?, pair.last()?);
            Some((next_y - y).hypot(next_z - z)).filter(|step| *step > 0.0)
        });
        let spacing = median_magnitude(steps);
        repeats.retain(|([y, z], _)| {
            let distances = sample.points().map(|[_, other_y, other_z]| (other_y - y).hypot(other_z - z));
            let (at, near) = distances.fold((0_usize, 0_usize), |(at, near), distance| {
                (at + usize::from(distance == 0.0), near + usize::from(distance > 0.0 && distance <= spacing))
            });
            at > near
        });
    }
    repeats.into_iter().map(|(point, _)| point).collect()
}

/// −ln of a bound (Chernoff) of the probability of `count` or more if `rate` are expected.
fn poisson_evidence(count: f64, rate: f64) -> f64 {
    if count > rate { rate - count + count * (count / rate).ln() } else { 0.0 }
}

/// −ln of a bound (Chernoff) of the probability that `count` or more of `of` points have a value of probability `share`.
fn binomial_evidence(count: f64, of: f64, share: f64) -> f64 {
    let ratio = count / of;
    if !(ratio > share && share > 0.0) {
        return 0.0;
    }
    let others = if ratio < 1.0 { (1.0 - ratio) * ((1.0 - ratio) / (1.0 - share)).ln() } else { 0.0 };
    of * (ratio * (ratio / share).ln() + others)
}

/// A frequent z and its count.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    z: f64,
    count: usize,
}

/// Every z of the sample with its count, in order.
fn counts(sample: &Sample) -> Vec<Candidate> {
    let mut zs: Vec<f64> = sample.points().map(|[_, _, z]| z + 0.0).collect();
    zs.sort_unstable_by(f64::total_cmp);
    let runs = zs.chunk_by(|a, b| a == b);
    runs.filter_map(|run| Some(Candidate { z: *run.first()?, count: run.len() })).collect()
}

/// The most frequent of the values.
fn candidates(values: &[Candidate]) -> Vec<Candidate> {
    let points_count: usize = values.iter().map(|value| value.count).sum();
    let least = (points_count as f64 * SHARE_MIN).max(2.0);
    let mut candidates: Vec<Candidate> = values.iter().filter(|value| value.count as f64 >= least).copied().collect();
    candidates.sort_unstable_by(|a, b| b.count.cmp(&a.count).then(a.z.total_cmp(&b.z)));
    candidates
}

fn repeated_heights(sample: &Sample) -> Vec<Pattern> {
    let values = counts(sample);
    let candidates = candidates(&values);
    if candidates.is_empty() {
        return Vec::new();
    }
    let noise = Noise::of(sample, &candidates);
    let needed = evidence_needed(values.len());
    let is_missing = |candidate: &Candidate| {
        let count = candidate.count as f64;
        let (next, around) = beside(&values, candidate, 3.0 * noise.sigma);
        // On a surface whose noise exceeds three quarters of a step, the neighbouring steps together have more points than the step
        // itself, even for the lowest noise: erf(q / (2√2 σ)) < 1/2.
        count > next as f64
            && (binomial_evidence(count, count + around.max(next) as f64, noise.most_of_one_value()) > needed
                || noise.is_ordered && single_jumps(sample, candidate.z, noise.jump) as f64 * LN_2 > needed
                || noise.is_beyond(candidate.z) && count * LN_2 > needed)
    };
    let missing = candidates.iter().filter(|candidate| is_missing(candidate));
    missing.map(|candidate| with_common_y(sample, candidate)).collect()
}

/// The number of points at the next lower and the next higher z together, and of those within `width` of the candidate.
fn beside(values: &[Candidate], candidate: &Candidate, width: f64) -> (usize, usize) {
    let place = values.partition_point(|value| value.z < candidate.z);
    let before = values.get(..place).unwrap_or_default();
    let after = values.get(place + 1..).unwrap_or_default();
    let count = |value: Option<&Candidate>| value.map_or(0, |value| value.count);
    let within = |value: &&Candidate| (value.z - candidate.z).abs() <= width;
    let sum = |values: &mut dyn Iterator<Item = &Candidate>| values.map(|value| value.count).sum::<usize>();
    let around = sum(&mut before.iter().rev().take_while(within)) + sum(&mut after.iter().take_while(within));
    (count(before.last()) + count(after.first()), around)
}

/// The number of single points with this z whose predecessors and successors lie farther away than `jump`.
///
/// If a horizontal surface has either of two z with equal probability, n features of one point's width hit one of them by chance
/// with 2⁻ⁿ.
fn single_jumps(sample: &Sample, z: f64, jump: f64) -> usize {
    let far = |other: f64| jump.is_finite() && (other - z).abs() > jump;
    let jumps = |stretch: &Vec<[f64; 3]>| {
        let triples = stretch.windows(3).filter(|triple| match triple {
            [[_, _, before], [_, _, here], [_, _, after]] => *here == z && far(*before) && far(*after),
            _ => false,
        });
        triples.count()
    };
    sample.stretches.iter().map(jumps).sum()
}

/// The pattern of a missing z: all coordinates if most of the points have one y.
fn with_common_y(sample: &Sample, candidate: &Candidate) -> Pattern {
    let mut ys: HashMap<u64, (f64, usize)> = HashMap::new();
    for [_, y, _] in sample.points().filter(|[_, _, z]| *z == candidate.z) {
        ys.entry(key(y)).or_insert((y, 0)).1 += 1;
    }
    let common = ys.into_values().find(|(_, count)| count * 2 > candidate.count);
    common.map_or(Pattern::Z(candidate.z), |(y, _)| Pattern::Point { y, z: candidate.z })
}

/// Noise of z and the lattice of its values, without the most frequent candidates.
#[derive(Debug, Clone, Copy)]
struct Noise {
    /// Standard deviation of a point relative to its neighbours along the profile, mm; 0 if the points follow a curve without
    /// noise, or if the file does not list them along a curve.
    sigma: f64,
    /// Whether successive points lie close together relative to the spread of all.
    is_ordered: bool,
    /// Step of the lattice of values, mm.
    step: f64,
    /// Difference of z that does not occur between neighbours on a surface, mm.
    jump: f64,
    /// The range of z without a hundredth at either end.
    range: [f64; 2],
    /// The larger extent of y and z, without the same share.
    width: f64,
}

impl Noise {
    fn of(sample: &Sample, candidates: &[Candidate]) -> Self {
        let left_out = candidates.get(..LEFT_OUT_MAX).unwrap_or(candidates);
        let is_left_out = |z: f64| left_out.iter().any(|candidate| candidate.z == z);
        let rest = || sample.points().filter(|[_, _, z]| !is_left_out(*z));
        let mut zs: Vec<f64> = rest().map(|[_, _, z]| z).collect();
        let mut ys: Vec<f64> = rest().map(|[_, y, _]| y).collect();
        zs.sort_unstable_by(f64::total_cmp);
        ys.sort_unstable_by(f64::total_cmp);
        let (range, across) = (bulk(&zs), bulk(&ys));
        let mut steps: Vec<f64> =
            zs.windows(2).filter_map(|pair| Some(pair.last()? - pair.first()?)).filter(|step| *step > 0.0).collect();
        steps.sort_unstable_by(f64::total_cmp);
        // Not the smallest difference, so that single values off the lattice have no effect.
        let step = steps.get(steps.len() / 100).copied().unwrap_or(f64::INFINITY);
        let middle = zs.get(zs.len() / 2).copied().unwrap_or(0.0);
        let spread = 1.4826 * median_magnitude(zs.iter().map(|z| z - middle));
        let extent = |[low, high]: [f64; 2]| high - low;
        let (local, alternates) = local_scatter(sample, is_left_out);
        let is_ordered = local < 0.25 * spread;
        let sigma = if is_ordered && alternates { local } else { 0.0 };
        // Beyond the spread of the points of the scan plus noise (4 σ, once in 16 000 points) and lattice.
        let jump = spread + 4.0 * (local + step);
        Self { sigma, is_ordered, step, jump, range, width: extent(range).max(extent(across)) }
    }

    /// Largest share of a horizontal surface's points in its most frequent value: the step in the middle of a normal distribution,
    /// for a surface that is [`QUIETER`].
    fn most_of_one_value(&self) -> f64 {
        if self.sigma > 0.0 { erf(self.step * QUIETER / (self.sigma * 8f64.sqrt())) } else { 1.0 }
    }

    fn is_beyond(&self, z: f64) -> bool {
        let [low, high] = self.range;
        self.width > 0.0 && (low - z).max(z - high) > DEPTHS_MAX * self.width
    }
}

/// The 1st and the 99th percentile.
fn bulk(sorted: &[f64]) -> [f64; 2] {
    let last = sorted.len().saturating_sub(1);
    let at = |index: usize| sorted.get(index).copied().unwrap_or(0.0);
    [at(last / 100), at(last - last / 100)]
}

fn median_magnitude(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.map(f64::abs).collect();
    let middle = values.len() / 2;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

/// Standard deviation of z along the profile from third differences, to which a smooth section hardly contributes. White noise of σ
/// gives them a standard deviation of √20 σ and lets successive ones differ in sign (correlation −3/4); those of a curve without
/// noise keep their sign. The second result is whether they mostly differ. For points in no order the first is the spread of the
/// complete scan.
fn local_scatter(sample: &Sample, is_left_out: impl Fn(f64) -> bool) -> (f64, bool) {
    let (mut thirds, mut kept, mut changed) = (Vec::new(), 0_usize, 0_usize);
    for stretch in &sample.stretches {
        let mut before = 0.0;
        for four in stretch.windows(4) {
            let &[[_, _, a], [_, _, b], [_, _, c], [_, _, d]] = four else { continue };
            // The differences are skipped, rather than taken over a gap, where the slope would count as noise.
            if [a, b, c, d].into_iter().any(&is_left_out) {
                before = 0.0;
                continue;
            }
            let third = (d - a) - 3.0 * (c - b);
            kept += usize::from(third * before > 0.0);
            changed += usize::from(third * before < 0.0);
            before = third;
            thirds.push(third.abs());
        }
    }
    // The lower quartile of the magnitudes, 0.3186 σ, because spikes, edges and gaps of drop-outs increase most of the differences.
    let quartile = thirds.len() / 4;
    let low = if thirds.is_empty() { 0.0 } else { *thirds.select_nth_unstable_by(quartile, f64::total_cmp).1 };
    (low / 0.3186 / 20f64.sqrt(), changed > kept)
}
