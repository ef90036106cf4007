mod common;
use std::time::Instant;
fn main() {
    let root = common::assets();
    for f in std::env::args().skip(1) {
        let t = Instant::now();
        match relight::scene::load(&root.join(&f)) {
            Ok(a) => println!(
                "{f}: {} tri {} vert mats {} tex {} lights {:?} cams {:?} bounds {:?} uv {} {} col {} in {:?}\n  {:#?}",
                a.mesh.triangles.len(),
                a.mesh.positions.len(),
                a.materials.len(),
                a.textures.len(),
                a.lights,
                a.cameras,
                a.mesh.bounds(),
                a.mesh.uvs[0].len(),
                a.mesh.uvs[1].len(),
                a.mesh.colours.len(),
                t.elapsed(),
                a.warnings
            ),
            Err(e) => println!("{e}"),
        }
    }
}
