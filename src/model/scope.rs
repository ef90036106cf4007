//! How far a direct vector lies from what a model was trained on (METHOD section 11).
//!
//! One linear classifier for each kind of light that the scenario does not have tells its direct vectors from the scenario's.
//! The reading is the strongest of them: a light that looks like another kind is unlike what was trained on.

use crate::math::Rgb;

/// Tells direct vectors of a model's scenario from those of other lights.
#[derive(Clone, Debug, PartialEq)]
pub struct Scope {
    /// Kinds of light that the scenario does not have, as scene files name them.
    pub kinds: Vec<String>,
    /// P.
    pub points: usize,
    /// Per kind the weights of the 2 P features, and a constant: `[kind][2 P + 1]`.
    pub weights: Vec<f32>,
}

/// What a [`Scope`] makes of a direct vector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading<'s> {
    /// From 0, seen, to 1, unlike anything trained on. One in twenty held-out lights of the scenario read more than 1/2.
    pub novelty: f32,
    /// The kind of light that it is most like among those that the scenario does not have.
    pub like: &'s str,
}

/// What a direct vector is told by, whatever its brightness: x over its norm, and the fourth root of that over its norm, in
/// which dim light counts, too. x is the mean of the channels. `None` for a vector without light.
pub fn features(direct: &[Rgb]) -> Option<Vec<f32>> {
    let grey: Vec<f32> = direct.iter().map(|x| x.element_sum().max(0.0)).collect();
    let unit = |values: &[f32]| -> Option<Vec<f32>> {
        // In f64: the square of what f32 holds does not overflow.
        let norm = values.iter().map(|&v| (v as f64).powi(2)).sum::<f64>().sqrt();
        (norm > 0.0 && norm.is_finite()).then(|| values.iter().map(|&v| (v as f64 / norm) as f32).collect())
    };
    let bright = unit(&grey)?;
    let dim = unit(&bright.iter().map(|v| v.sqrt().sqrt()).collect::<Vec<_>>())?;
    Some([bright, dim].concat())
}

impl Scope {
    /// How far `direct`, one colour per measurement point, is from the scenario. `None` without light.
    pub fn read(&self, direct: &[Rgb]) -> Option<Reading<'_>> {
        assert_eq!(direct.len(), self.points, "direct vector of another point set");
        let features = features(direct)?;
        let logit = |row: &[f32]| row.iter().zip(&features).map(|(w, f)| w * f).sum::<f32>() + row[features.len()];
        let rows = self.weights.chunks_exact(features.len() + 1);
        let strongest = self.kinds.iter().zip(rows.map(logit)).max_by(|a, b| a.1.total_cmp(&b.1));
        strongest.map(|(kind, logit)| Reading { novelty: 1.0 / (1.0 + (-logit).exp()), like: kind })
    }
}

impl Reading<'_> {
    /// In words.
    pub fn verdict(&self) -> String {
        let percent = 100.0 * self.novelty;
        match self.novelty {
            ..0.5 => format!("seen ({percent:.0} % novel)"),
            0.5..0.9 => format!("unusual ({percent:.0} % novel, nearest to {} light)", self.like),
            _ => format!("unlike anything trained on ({percent:.0} % novel, looks like {} light)", self.like),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn brightness_makes_no_difference_and_darkness_is_no_reading() {
        let direct = [Rgb::new(1.0, 0.5, 0.0), Rgb::ZERO, Rgb::splat(1e-3), Rgb::X];
        let scope = Scope {
            kinds: vec!["point".into(), "sky".into()],
            points: 4,
            weights: (0..18).map(|i| ((i * 7) % 5) as f32 - 2.0).collect(),
        };
        let reading = scope.read(&direct).unwrap();
        for scale in [1e-18, 1e-3, 4.0, 1e18] {
            let scaled = scope.read(&direct.map(|x| x * scale)).unwrap();
            assert_eq!(scaled.like, reading.like);
            // The logit is a sum of nine terms of at most 2, each rounded to 6e-8 of itself.
            assert!((scaled.novelty - reading.novelty).abs() < 1e-6, "{scale}: {}", scaled.novelty);
        }
        assert_eq!(scope.read(&[Rgb::ZERO; 4]), None);
    }
}
