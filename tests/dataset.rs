//! The dataset: what its bits depend on, and what happens when its bake is cut short, goes on, or is not what it was.

use std::ops::Range;

use glam::Vec3;
use relight::light::{Light, LightingCondition};
use relight::progress::Silent;
use relight::scene::{Asset, Lightmap, Search, Tracer, UvPolicy, generate, lay_out};
use relight::transport::{BakeSettings, Baker, Integrator};

const SIZE: u32 = 16;

/// A Cornell box whose second material glows.
fn glowing_cornell() -> (Asset, Lightmap) {
    let mut asset = generate("cornell").unwrap();
    asset.materials[1].emissive = Vec3::new(0.5, 0.25, 0.0);
    lay_out(&mut asset, SIZE, UvPolicy::Auto).unwrap();
    let lightmap = Lightmap::new(&asset.mesh, SIZE as usize);
    (asset, lightmap)
}

/// Every kind of light, more than one in some conditions.
fn conditions() -> Vec<LightingCondition> {
    let point =
        |x: f32| Light::Point { position: Vec3::new(x, 4.0, 2.0), color: Vec3::ONE, intensity: 20.0, range: None };
    let spot = Light::Spot {
        position: Vec3::new(2.0, 5.0, 2.0),
        direction: Vec3::NEG_Y,
        color: Vec3::new(1.0, 0.5, 0.25),
        intensity: 9.0,
        range: Some(20.0),
        inner_cone_angle: 0.1,
        outer_cone_angle: 0.7,
    };
    let sun = Light::Directional { direction: Vec3::Z, color: Vec3::ONE, intensity: 2.0 };
    let glow = Light::Emissive { scale: 1.5 };
    [vec![point(1.0), point(4.0)], vec![spot], vec![point(2.0), glow.clone()], vec![sun], vec![glow], vec![point(3.0)]]
        .map(|lights| LightingCondition { lights })
        .into()
}

/// Bits of I, `[condition][texel][channel]`, baked in batches of conditions and in ranges of texels.
fn bits(tracer: &Tracer, lightmap: &Lightmap, seed: u64, batches: &[Range<usize>], cut: usize) -> Vec<Vec<u32>> {
    let settings = BakeSettings { paths: 8, max_bounces: 6, seed, integrator: Integrator::Path };
    let (conditions, texels) = (conditions(), lightmap.texels.len());
    let mut out = vec![Vec::new(); conditions.len()];
    for batch in batches {
        let baker = Baker::new(tracer, lightmap, &conditions[batch.clone()], &settings, &Silent).unwrap();
        for start in (0..texels).step_by(cut) {
            let baked = baker.texels(start..(start + cut).min(texels), &Silent).unwrap();
            for (i, value) in baked.indirect.iter().enumerate() {
                out[batch.start + i % batch.len()].push(value.to_bits());
            }
        }
    }
    out
}

#[test]
fn a_conditions_bits_depend_on_no_other_condition_no_cut_and_no_threads() {
    let (asset, lightmap) = glowing_cornell();
    for search in [Search::Brute, Search::Tree] {
        let tracer = Tracer::with_search(&asset, search);
        let run = |threads: usize, seed: u64, batches: &[Range<usize>], cut: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| bits(&tracer, &lightmap, seed, batches, cut))
        };
        let together = run(1, 7, &[0..6], lightmap.texels.len());
        for (condition, values) in together.iter().enumerate() {
            assert!(values.iter().any(|&v| v != 0), "condition {condition} is lit");
        }
        assert!(together == run(2, 7, &[0..6], 100), "other ranges");
        assert!(together == run(2, 7, &[0..1, 1..4, 4..5, 5..6], 33), "other batches");
        assert!(together[0] != run(2, 8, &[0..6], 33)[0], "control: another seed");
    }
}
