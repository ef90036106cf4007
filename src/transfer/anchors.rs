//! Anchors of a local basis: where they stand, and how a texel's coefficients are interpolated between them.
//!
//! Centres of k-means clusters (Lloyd 1982; begun by k-means++, Arthur and Vassilvitskii 2007) over where a texel is and how
//! it faces, so that the two sides of a wall have anchors of their own.

use glam::Vec3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

use crate::model::Anchors;

/// What a difference of unit normals counts against a distance of the asset's extent. Twice as much raised the error of statue and
/// interior by 1 to 3 % of itself and lowered cornell's by less.
const NORMAL_WEIGHT: f32 = 0.1;

const PASSES: usize = 20;

/// Texels that clusters are made from; of more, evenly spread ones.
const MOST_SAMPLES: usize = 1 << 16;

/// Where a texel is, relative to the asset's extent, and how it faces.
type Place = [f32; 6];

fn distance_squared(a: &Place, b: &Place) -> f32 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum()
}

/// At most `count` anchors (256 at most) and the interpolation of each texel between them, from the texels' positions and
/// normals; anchors are denser where `weights` are higher. The same for the same texels.
pub fn place(spots: &[(Vec3, Vec3)], weights: &[f32], count: usize) -> Anchors {
    let (low, high) = spots.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), s| (l.min(s.0), h.max(s.0)));
    let extent = (high - low).length().max(f32::MIN_POSITIVE);
    let places: Vec<Place> = spots
        .par_iter()
        .map(|&(position, normal)| {
            let (p, n) = ((position - low) / extent, normal * NORMAL_WEIGHT);
            [p.x, p.y, p.z, n.x, n.y, n.z]
        })
        .collect();
    let centres = centres(&places, weights, count.min(256));
    let blends: Vec<([u8; 4], [u8; 4])> = places.par_iter().map(|place| blend(place, &centres)).collect();
    let (indices, shares) = blends.into_iter().unzip();
    Anchors { count: centres.len(), indices, shares }
}

/// Centres of k-means clusters; fewer than `count` where there are fewer different places.
fn centres(places: &[Place], weights: &[f32], count: usize) -> Vec<Place> {
    let stride = places.len().div_ceil(MOST_SAMPLES).max(1);
    let samples: Vec<Place> = places.iter().copied().step_by(stride).collect();
    let weights: Vec<f64> = weights.iter().step_by(stride).map(|&w| w as f64).collect();
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    let mut centres: Vec<Place> = samples.first().copied().into_iter().collect();
    let mut nearest = vec![f32::INFINITY; samples.len()];
    while (1..count).contains(&centres.len()) {
        let newest = centres[centres.len() - 1];
        nearest.par_iter_mut().zip(&samples).for_each(|(d, s)| *d = d.min(distance_squared(s, &newest)));
        let total: f64 = nearest.iter().zip(&weights).map(|(&d, w)| d as f64 * w).sum();
        if total <= 0.0 {
            break;
        }
        // The next one with a probability that grows with its squared distance from the others.
        let mut left = rng.random::<f64>() * total;
        let drawn = nearest.iter().zip(&weights).position(|(&d, w)| {
            left -= d as f64 * w;
            left <= 0.0 && d > 0.0
        });
        let farthest = || (0..samples.len()).max_by(|&a, &b| nearest[a].total_cmp(&nearest[b])).unwrap_or(0);
        centres.push(samples[drawn.unwrap_or_else(farthest)]);
    }
    for _ in 0..PASSES {
        let owners: Vec<usize> = samples.par_iter().map(|s| by_distance(s, &centres)[0].1).collect();
        let mut sums = vec![([0f64; 6], 0f64); centres.len()];
        for ((sample, &owner), &w) in samples.iter().zip(&owners).zip(&weights) {
            let (sum, weight) = &mut sums[owner];
            sum.iter_mut().zip(sample).for_each(|(sum, &v)| *sum += v as f64 * w);
            *weight += w;
        }
        for (centre, (sum, weight)) in centres.iter_mut().zip(&sums).filter(|(_, (_, weight))| *weight > 0.0) {
            *centre = sum.map(|s| (s / *weight) as f32);
        }
    }
    centres
}

/// The five nearest centres, or all where there are fewer, with their distances.
fn by_distance(place: &Place, centres: &[Place]) -> Vec<(f32, usize)> {
    let mut nearest: Vec<(f32, usize)> = Vec::with_capacity(6);
    for (k, centre) in centres.iter().enumerate() {
        let d = distance_squared(place, centre);
        let at = nearest.partition_point(|n| n.0 <= d);
        if at < 5 {
            nearest.insert(at, (d, k));
            nearest.truncate(5);
        }
    }
    nearest.iter_mut().for_each(|n| n.0 = n.0.sqrt());
    nearest
}

/// φ of the four nearest anchors, max(1 − d/d₅, 10⁻⁶)² up to a factor: an anchor's share is nothing where another one takes its
/// place. In 255ths, rounded so that they add up; the scale is left at 1.
fn blend(place: &Place, centres: &[Place]) -> ([u8; 4], [u8; 4]) {
    let nearest = by_distance(place, centres);
    // Where there are no five, all have a share everywhere.
    let border = nearest.get(4).map_or(f32::INFINITY, |n| n.0);
    let mut shares = [0f32; 4];
    let mut indices = [0u8; 4];
    for (i, &(d, k)) in nearest.iter().take(4).enumerate() {
        let inside = if border > 0.0 { 1.0 - d / border } else { 0.0 };
        shares[i] = inside.max(1e-6).powi(2);
        indices[i] = k as u8;
    }
    let total: f32 = shares.iter().sum();
    let exact = shares.map(|s| s / total * 255.0);
    let mut weights = exact.map(|s| s as u8);
    // What rounding down left over goes to the largest remainders.
    let mut order = [0, 1, 2, 3];
    order.sort_by(|&a, &b| exact[b].fract().total_cmp(&exact[a].fract()));
    let left = 255 - weights.iter().map(|&w| w as usize).sum::<usize>();
    (0..left).for_each(|i| weights[order[i % 4]] += 1);
    weights[3] = u8::MAX;
    (indices, weights)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plane(side: usize, height: f32, normal: Vec3) -> Vec<(Vec3, Vec3)> {
        let at = |i: usize| Vec3::new((i % side) as f32, (i / side) as f32, height) / side as f32;
        (0..side * side).map(|i| (at(i), normal)).collect()
    }

    fn of_equal_weight(spots: &[(Vec3, Vec3)], count: usize) -> Anchors {
        place(spots, &vec![1.0; spots.len()], count)
    }

    /// Shares are continuous: between texels a quarter as far apart they change about a quarter as much, where the nearest anchor
    /// jumps by as much as ever.
    #[test]
    fn shares_are_continuous() {
        let largest = |side: usize| {
            let anchors = of_equal_weight(&plane(side, 0.0, Vec3::Z), 32);
            let share = |t: usize, k: usize| -> f32 { anchors.of(t).iter().filter(|a| a.0 == k).map(|a| a.1).sum() };
            let (mut of_shares, mut jumps) = (0f32, 0);
            for t in (0..side * side).filter(|t| t % side + 1 < side) {
                let change = |k: usize| (share(t, k) - share(t + 1, k)).abs();
                of_shares = (0..anchors.count).map(change).fold(of_shares, f32::max);
                jumps += (anchors.indices[t][0] != anchors.indices[t + 1][0]) as usize;
            }
            assert!(jumps > 0);
            of_shares
        };
        let (coarse, fine) = (largest(64), largest(256));
        assert!(fine < 0.4 * coarse, "{fine} and {coarse}");
    }

    /// The nearest anchor is one of the own side.
    #[test]
    fn the_sides_of_a_thin_wall_have_anchors_of_their_own() {
        let side = 64;
        let spots = [plane(side, 0.0, Vec3::Z), plane(side, 0.01, Vec3::NEG_Z)].concat();
        let anchors = of_equal_weight(&spots, 64);
        let (front, back) = anchors.indices.split_at(side * side);
        let main = |texels: &[[u8; 4]]| texels.iter().map(|k| k[0]).collect::<std::collections::BTreeSet<u8>>();
        assert!(main(front).is_disjoint(&main(back)), "{:?} {:?}", main(front), main(back));
    }

    #[test]
    fn anchors_are_denser_where_weights_are_higher() {
        let spots = plane(64, 0.0, Vec3::Z);
        let left = |t: usize| t % 64 < 32;
        let weights: Vec<f32> = (0..spots.len()).map(|t| if left(t) { 100.0 } else { 1.0 }).collect();
        let main_anchors = |anchors: &Anchors| -> usize {
            let of = |t: usize| anchors.indices[t][0];
            (0..spots.len()).filter(|&t| left(t)).map(of).collect::<std::collections::BTreeSet<u8>>().len()
        };
        let (even, uneven) = (main_anchors(&of_equal_weight(&spots, 32)), main_anchors(&place(&spots, &weights, 32)));
        assert!(uneven > even + 5, "{uneven} and {even}");
    }

    #[test]
    fn few_or_equal_texels_have_few_anchors() {
        let equal = vec![(Vec3::ONE, Vec3::Z); 50];
        for (spots, expected) in [(plane(1, 0.0, Vec3::Z), 1), (equal, 1), (plane(2, 0.0, Vec3::Z), 4)] {
            let anchors = of_equal_weight(&spots, 64);
            assert_eq!(anchors.count, expected);
            assert!((0..spots.len()).all(|t| anchors.of(t).iter().all(|a| a.1 >= 0.0 && a.0 < expected)));
        }
        assert_eq!(of_equal_weight(&[], 64).count, 0);
    }
}
