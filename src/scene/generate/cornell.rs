//! The Cornell box as measured: geometry and reflectances published by the Program of Computer Graphics, Cornell
//! University (*Cornell Box Data*, 1998), in units of 1 mm there and of 1 dm here, so that a light's inverse square falls
//! over a room of 5.5 m.
//!
//! Without the ceiling's light opening, since lights come from the scenario. The floor is cut out under the blocks.

use glam::Vec3;

use super::MeshBuilder;
use crate::scene::{Asset, Camera};

/// Corners of the blocks' tops, counter-clockwise as seen from above, data units.
const SHORT_BLOCK: [[f32; 2]; 4] = [[130.0, 65.0], [82.0, 225.0], [240.0, 272.0], [290.0, 114.0]];
const SHORT_HEIGHT: f32 = 165.0;
const TALL_BLOCK: [[f32; 2]; 4] = [[423.0, 247.0], [265.0, 296.0], [314.0, 456.0], [472.0, 406.0]];
const TALL_HEIGHT: f32 = 330.0;

/// Metres from data units.
const SCALE: f32 = 0.01;

fn point(x: f32, y: f32, z: f32) -> Vec3 {
    Vec3::new(x, y, z) * SCALE
}

pub fn cornell() -> Asset {
    let mut mesh = MeshBuilder::default();
    // The published spectra as linear Rec. 709 under a flat illuminant.
    let white = mesh.lambert("white", Vec3::new(0.725, 0.71, 0.68));
    let red = mesh.lambert("red", Vec3::new(0.63, 0.065, 0.05));
    let green = mesh.lambert("green", Vec3::new(0.14, 0.45, 0.091));

    let footprint = |block: [[f32; 2]; 4]| block.map(|[x, z]| point(x, 0.0, z)).to_vec();
    mesh.polygon_with_holes(
        &[point(552.8, 0.0, 0.0), point(0.0, 0.0, 0.0), point(0.0, 0.0, 559.2), point(549.6, 0.0, 559.2)],
        &[footprint(SHORT_BLOCK), footprint(TALL_BLOCK)],
        white,
    );
    let ceiling = [[556.0, 0.0], [556.0, 559.2], [0.0, 559.2], [0.0, 0.0]];
    mesh.polygon(&ceiling.map(|[x, z]| point(x, 548.8, z)), white);
    mesh.polygon(
        &[point(549.6, 0.0, 559.2), point(0.0, 0.0, 559.2), point(0.0, 548.8, 559.2), point(556.0, 548.8, 559.2)],
        white,
    );
    mesh.polygon(
        &[point(0.0, 0.0, 559.2), point(0.0, 0.0, 0.0), point(0.0, 548.8, 0.0), point(0.0, 548.8, 559.2)],
        green,
    );
    // The data's one wall that is not quite flat: its lower edge leans by 3 mm in 559.
    mesh.polygon(
        &[point(552.8, 0.0, 0.0), point(549.6, 0.0, 559.2), point(556.0, 548.8, 559.2), point(556.0, 548.8, 0.0)],
        red,
    );
    for (base, height) in [(SHORT_BLOCK, SHORT_HEIGHT), (TALL_BLOCK, TALL_HEIGHT)] {
        mesh.polygon(&base.map(|[x, z]| point(x, height, z)), white);
        for i in 0..4 {
            let ([ax, az], [bx, bz]) = (base[i], base[(i + 1) % 4]);
            mesh.polygon(
                &[point(bx, 0.0, bz), point(bx, height, bz), point(ax, height, az), point(ax, 0.0, az)],
                white,
            );
        }
    }
    // The published camera: 35 mm focal length, 25 mm film.
    let camera =
        Camera { eye: point(278.0, 273.0, -800.0), target: point(278.0, 273.0, 0.0), up: Vec3::Y, vertical_fov: 39.3 };
    mesh.finish("cornell", camera)
}
