//! Datasets of some conditions of others.

use super::folder::Shards;
use super::{Dataset, DatasetError, Indirect};
use crate::progress::Progress;

impl Dataset {
    /// Some conditions, none twice, of datasets of the same texels and points, in this order; the first `training` are to train
    /// on. What is in folders stays there.
    ///
    /// # Errors
    /// When lightmaps have to be read and cannot be, or `progress` cancels.
    pub fn gather(
        parts: &[(&Dataset, Vec<usize>)],
        training: usize,
        progress: &dyn Progress,
    ) -> Result<Self, DatasetError> {
        let picks = || parts.iter().flat_map(|(of, picks)| picks.iter().map(move |&pick| (*of, pick)));
        let n = picks().count();
        let rows = parts.first().map_or(0, |(of, _)| 3 * of.points());
        let mut direct = vec![0f32; rows * n];
        for (c, (of, pick)) in picks().enumerate() {
            let width = of.conditions.len();
            (0..rows).for_each(|row| direct[row * n + c] = of.direct[row * width + pick]);
        }
        Ok(Self {
            conditions: picks().map(|(of, pick)| of.conditions[pick].clone()).collect(),
            training,
            direct,
            indirect: gather_indirect(parts, n, progress)?,
            texel_areas: parts.first().map_or(Vec::new(), |(of, _)| of.texel_areas.clone()),
            noise: picks().map(|(of, pick)| of.noise[pick]).collect(),
        })
    }
}

/// Shards, and for each of their conditions the one that it becomes.
type InFolder<'s> = (&'s Shards, Vec<Option<u32>>);

fn gather_indirect(
    parts: &[(&Dataset, Vec<usize>)],
    n: usize,
    progress: &dyn Progress,
) -> Result<Indirect, DatasetError> {
    let starts = parts.iter().scan(0, |end, (_, picks)| {
        *end += picks.len();
        Some(*end - picks.len())
    });
    let in_folders: Option<Vec<InFolder>> = (parts.iter().zip(starts.clone()))
        .map(|((of, picks), start)| match &of.indirect {
            Indirect::Memory(_) | Indirect::Roots { .. } => None,
            Indirect::Folder(shards) => {
                let mut becomes = vec![None; of.conditions.len()];
                picks.iter().enumerate().for_each(|(i, &pick)| becomes[pick] = Some((start + i) as u32));
                Some((shards, becomes))
            }
        })
        .collect();
    if let Some(parts) = in_folders {
        return Ok(Indirect::Folder(Shards::gather(&parts)));
    }
    let mut values = vec![0f32; parts.first().map_or(0, |(of, _)| 3 * of.texels()) * n];
    for ((of, picks), start) in parts.iter().zip(starts) {
        of.for_each_rows(progress, |texels, rows| {
            let out = values[3 * texels.start * n..].chunks_exact_mut(n.max(1));
            for (row, out) in rows.chunks_exact(of.conditions.len().max(1)).zip(out) {
                picks.iter().zip(&mut out[start..]).for_each(|(&pick, out)| *out = row[pick]);
            }
        })?;
    }
    Ok(Indirect::Memory(values))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::LightingCondition;
    use crate::progress::Silent;

    /// T = 2, P = 1; every value says whose it is: condition, row, and which dataset.
    fn dataset(n: usize, mark: f32) -> Dataset {
        let value = |row: usize, c: usize| mark + (10 * row + c) as f32;
        let rows = |count: usize| (0..count).flat_map(|r| (0..n).map(move |c| value(r, c))).collect::<Vec<f32>>();
        Dataset {
            conditions: vec![LightingCondition { lights: Vec::new() }; n],
            training: n,
            direct: rows(3),
            indirect: Indirect::Memory(rows(6)),
            texel_areas: vec![1.0, 2.0],
            noise: (0..n).map(|c| mark + c as f32).collect(),
        }
    }

    #[test]
    fn conditions_of_two_datasets_keep_their_light() {
        let (a, b) = (dataset(4, 1000.0), dataset(3, 2000.0));
        let both = Dataset::gather(&[(&a, vec![3, 1]), (&b, vec![0])], 2, &Silent).unwrap();
        assert_eq!((both.training, both.held_out(), both.points()), (2, 2..3, 1));
        assert_eq!(both.noise, [1003.0, 1001.0, 2000.0]);
        let expected: Vec<f32> =
            (0..6).flat_map(|row| [1003.0, 1001.0, 2000.0].map(|v| v + (10 * row) as f32)).collect();
        assert_eq!(both.direct, expected[..9]);
        assert!(matches!(&both.indirect, Indirect::Memory(values) if *values == expected));
    }
}
