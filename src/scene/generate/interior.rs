//! A furnished room with four columns, a doorway and a window: light that enters at one end reaches the other by several
//! bounces and round corners.

use glam::{Vec2, Vec3};

use super::MeshBuilder;
use super::builder::{Cover, ring};
use crate::scene::{Asset, Camera};

/// The room, metres; the origin is a corner of its floor.
const WIDTH: f32 = 8.0;
const HEIGHT: f32 = 3.2;
const DEPTH: f32 = 6.0;
/// Where the doorway in the +x wall and the window in the +z wall end.
pub const OUTSIDE_X: f32 = WIDTH + 0.2;
pub const OUTSIDE_Z: f32 = DEPTH + 0.25;

/// From the low to the high end along z, and the height, of the doorway.
const DOOR: [f32; 3] = [2.2, 3.2, 2.1];
/// Low and high corner (x, y) of the window.
const WINDOW: [Vec2; 2] = [Vec2::new(0.7, 1.0), Vec2::new(2.1, 2.3)];

const COLUMN_SEGMENTS: usize = 16;
const COLUMNS: [[f32; 2]; 4] = [[2.4, 1.7], [5.6, 1.7], [2.4, 4.3], [5.6, 4.3]];
/// (radius, height) from floor to ceiling.
const COLUMN: [[f32; 2]; 6] = [[0.26, 0.0], [0.26, 0.14], [0.18, 0.22], [0.16, 2.9], [0.26, 3.06], [0.26, HEIGHT]];

struct Palette {
    plaster: u32,
    wood: u32,
    ochre: u32,
    teal: u32,
    crimson: u32,
    blue: u32,
    white: u32,
}

/// The room under construction: things that stand on the floor leave their footprints.
struct Room {
    mesh: MeshBuilder,
    palette: Palette,
    footprints: Vec<Vec<Vec3>>,
}

pub fn interior() -> Asset {
    let mut mesh = MeshBuilder::default();
    let palette = Palette {
        plaster: mesh.lambert("plaster", Vec3::new(0.72, 0.70, 0.66)),
        wood: mesh.lambert("wood", Vec3::new(0.42, 0.26, 0.14)),
        ochre: mesh.lambert("ochre", Vec3::new(0.72, 0.42, 0.09)),
        teal: mesh.lambert("teal", Vec3::new(0.05, 0.42, 0.40)),
        crimson: mesh.lambert("crimson", Vec3::new(0.60, 0.05, 0.07)),
        blue: mesh.lambert("blue", Vec3::new(0.08, 0.16, 0.58)),
        white: mesh.lambert("white", Vec3::splat(0.8)),
    };
    let mut room = Room { mesh, palette, footprints: Vec::new() };
    room.columns();
    room.table(Vec3::new(3.2, 0.0, 2.55), Vec2::new(1.6, 0.9), true);
    for (x, facing) in [(3.3, 1.0), (4.2, 1.0), (3.3, -1.0), (4.2, -1.0)] {
        room.chair(Vec3::new(x, 0.0, if facing > 0.0 { 1.95 } else { 4.05 }), facing);
    }
    room.table(Vec3::new(6.4, 0.0, 4.9), Vec2::new(1.2, 0.6), false);
    room.bench(Vec3::new(0.1, 0.0, 1.9), 2.2);
    room.bookcase(Vec3::new(3.3, 0.0, 0.06));
    room.partition();
    room.shell();
    let camera =
        Camera { eye: Vec3::new(7.75, 1.7, 3.1), target: Vec3::new(2.8, 1.1, 2.5), up: Vec3::Y, vertical_fov: 58.0 };
    room.mesh.finish("interior", camera)
}

/// A horizontal rectangle from corner `min`, `size` along x and z.
fn rectangle(min: Vec3, size: Vec2) -> Vec<Vec3> {
    let max = min + Vec3::new(size.x, 0.0, size.y);
    [(min.x, min.z), (min.x, max.z), (max.x, max.z), (max.x, min.z)].map(|(x, z)| Vec3::new(x, min.y, z)).to_vec()
}

fn raised(outline: &[Vec3], height: f32) -> Vec<Vec3> {
    outline.iter().map(|&p| p + Vec3::Y * height).collect()
}

impl Room {
    /// Something swept up from its footprint on the floor; `covers` as for [`MeshBuilder::prism`], the underside aside.
    fn upright(&mut self, footprint: Vec<Vec3>, height: f32, mut covers: Vec<(Vec3, Cover)>, material: u32) {
        covers.push((Vec3::NEG_Y, Cover::Whole));
        self.mesh.prism(&footprint, Vec3::Y * height, &covers, material);
        self.footprints.push(footprint);
    }

    fn columns(&mut self) {
        let profile = COLUMN.map(Vec2::from);
        for [x, z] in COLUMNS {
            let foot = Vec3::new(x, 0.0, z);
            self.mesh.lathe(foot, &profile, COLUMN_SEGMENTS, self.palette.white);
            self.footprints.push(ring(foot, profile[0], COLUMN_SEGMENTS));
        }
    }

    /// Four legs, one in each corner of `area`, up to the underside at `height`; returns their upper ends.
    fn legs(&mut self, area: Vec3, size: Vec2, thickness: f32, height: f32) -> Vec<Vec<Vec3>> {
        let mut tops = Vec::new();
        for (along_x, along_z) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
            let room_between = size - thickness;
            let corner = area + Vec3::new(along_x * room_between.x, 0.0, along_z * room_between.y);
            let footprint = rectangle(corner, Vec2::splat(thickness));
            tops.push(raised(&footprint, height));
            self.upright(footprint, height, vec![(Vec3::Y, Cover::Whole)], self.palette.wood);
        }
        tops
    }

    fn table(&mut self, corner: Vec3, size: Vec2, with_vase: bool) {
        let (height, thickness) = (0.72, 0.05);
        let legs = self.legs(corner + Vec3::new(0.05, 0.0, 0.05), size - 0.1, 0.06, height);
        let underside = raised(&rectangle(corner, size), height);
        let mut covers = vec![(Vec3::NEG_Y, Cover::Parts(legs))];
        if with_vase {
            let foot = corner + Vec3::new(0.5 * size.x, height + thickness, 0.5 * size.y);
            covers.push((Vec3::Y, Cover::Parts(vec![self.vase(foot)])));
        }
        self.mesh.prism(&underside, Vec3::Y * thickness, &covers, self.palette.wood);
    }

    /// Returns its footprint.
    fn vase(&mut self, foot: Vec3) -> Vec<Vec3> {
        const SEGMENTS: usize = 20;
        let profile = [[0.06, 0.0], [0.11, 0.05], [0.135, 0.12], [0.12, 0.2], [0.07, 0.27], [0.05, 0.32], [0.07, 0.36]]
            .map(Vec2::from);
        self.mesh.lathe(foot, &profile, SEGMENTS, self.palette.teal);
        let mut lid = ring(foot, profile[profile.len() - 1], SEGMENTS);
        lid.reverse();
        self.mesh.polygon(&lid, self.palette.teal);
        ring(foot, profile[0], SEGMENTS)
    }

    /// A chair whose sitter looks along `facing` × z.
    fn chair(&mut self, near: Vec3, facing: f32) {
        const SEAT: Vec2 = Vec2::new(0.45, 0.42);
        let corner = if facing > 0.0 { near } else { near - Vec3::Z * SEAT.y };
        let inset = Vec3::new(0.02, 0.0, 0.02);
        let legs = self.legs(corner + inset, SEAT - 0.04, 0.04, 0.43);
        // The seat and its back in profile, seen along x.
        let rear = if facing > 0.0 { corner.z } else { corner.z + SEAT.y };
        let at = |forward: f32, height: f32| Vec3::new(corner.x, height, rear + facing * forward);
        let profile = [at(0.0, 0.43), at(SEAT.y, 0.43), at(SEAT.y, 0.47), at(0.04, 0.47), at(0.04, 0.9), at(0.0, 0.9)];
        let covers = [(Vec3::NEG_Y, Cover::Parts(legs))];
        self.mesh.prism(&profile, Vec3::X * SEAT.x, &covers, self.palette.ochre);
    }

    /// A bench of the given length along z that looks along +x.
    fn bench(&mut self, corner: Vec3, length: f32) {
        let at = |x: f32, y: f32| corner + Vec3::new(x, y, 0.0);
        let profile = [at(0.0, 0.0), at(0.8, 0.0), at(0.8, 0.42), at(0.2, 0.42), at(0.2, 0.85), at(0.0, 0.85)];
        let covers = [(Vec3::NEG_Y, Cover::Whole)];
        self.mesh.prism(&profile, Vec3::Z * length, &covers, self.palette.crimson);
        let footprint = [at(0.0, 0.0), at(0.8, 0.0)];
        let far = footprint.map(|p| p + Vec3::Z * length);
        self.footprints.push(vec![footprint[0], far[0], far[1], footprint[1]]);
    }

    /// A case of three by two compartments that open along +z, a row of books in most.
    fn bookcase(&mut self, corner: Vec3) {
        const CASE: Vec3 = Vec3::new(1.6, 1.5, 0.34);
        const BOARD: f32 = 0.04;
        const BACK: f32 = 0.03;
        let (columns, rows) = (2, 3);
        let inside = Vec2::new(
            (CASE.x - BOARD * (columns + 1) as f32) / columns as f32,
            (CASE.y - BOARD * (rows + 1) as f32) / rows as f32,
        );
        let mut openings = Vec::new();
        for i in 0..columns * rows {
            let (column, row) = ((i % columns) as f32, (i / columns) as f32);
            let low = Vec3::new(BOARD + column * (inside.x + BOARD), BOARD + row * (inside.y + BOARD), BACK) + corner;
            let high = Vec3::new(low.x + inside.x, low.y + inside.y, corner.z + CASE.z);
            openings.push(
                [
                    Vec3::new(low.x, low.y, high.z),
                    Vec3::new(high.x, low.y, high.z),
                    high,
                    Vec3::new(low.x, high.y, high.z),
                ]
                .to_vec(),
            );
            self.compartment(low, high, i);
        }
        let footprint = rectangle(corner, Vec2::new(CASE.x, CASE.z));
        self.upright(footprint, CASE.y, vec![(Vec3::Z, Cover::Parts(openings))], self.palette.wood);
    }

    /// The inside of a compartment, and its books.
    fn compartment(&mut self, low: Vec3, high: Vec3, number: usize) {
        let colours = [self.palette.crimson, self.palette.blue, self.palette.ochre, self.palette.teal];
        let books = (number != 3).then(|| {
            let size = Vec3::new(0.55 * (high.x - low.x), 0.62 * (high.y - low.y), 0.2);
            (low + Vec3::new(0.06 + 0.05 * (number % 3) as f32, 0.0, 0.05), size)
        });
        let board = rectangle(low, Vec2::new(high.x - low.x, high.z - low.z));
        let mut standing = Vec::new();
        if let Some((corner, size)) = books {
            let footprint = rectangle(corner, Vec2::new(size.x, size.z));
            let covers = [(Vec3::NEG_Y, Cover::Whole)];
            self.mesh.prism(&footprint, Vec3::Y * size.y, &covers, colours[number % colours.len()]);
            standing.push(footprint);
        }
        let wood = self.palette.wood;
        self.mesh.polygon_with_holes(&board, &standing, wood);
        let corner = |x: bool, y: bool, z: bool| {
            Vec3::new(if x { high.x } else { low.x }, if y { high.y } else { low.y }, if z { high.z } else { low.z })
        };
        let (f, t) = (false, true);
        self.mesh.polygon(&[corner(f, t, f), corner(t, t, f), corner(t, t, t), corner(f, t, t)], wood);
        self.mesh.polygon(&[corner(f, f, f), corner(t, f, f), corner(t, t, f), corner(f, t, f)], wood);
        self.mesh.polygon(&[corner(f, f, f), corner(f, t, f), corner(f, t, t), corner(f, f, t)], wood);
        self.mesh.polygon(&[corner(t, f, f), corner(t, f, t), corner(t, t, t), corner(t, t, f)], wood);
    }

    /// A low wall that parts the corner by the doorway.
    fn partition(&mut self) {
        self.upright(rectangle(Vec3::new(6.3, 0.0, 1.2), Vec2::new(1.2, 0.12)), 2.2, vec![], self.palette.blue);
    }

    /// Floor, ceiling, walls, doorway and window.
    fn shell(&mut self) {
        let Palette { plaster, ochre, teal, wood, .. } = self.palette;
        let at = Vec3::new;
        let [door_low, door_high, door_top] = DOOR;
        let floor = [
            at(0.0, 0.0, 0.0),
            at(0.0, 0.0, DEPTH),
            at(WIDTH, 0.0, DEPTH),
            at(WIDTH, 0.0, door_high),
            at(OUTSIDE_X, 0.0, door_high),
            at(OUTSIDE_X, 0.0, door_low),
            at(WIDTH, 0.0, door_low),
            at(WIDTH, 0.0, 0.0),
        ];
        self.mesh.polygon_with_holes(&floor, &self.footprints, wood);
        let capitals: Vec<Vec<Vec3>> = COLUMNS
            .iter()
            .map(|&[x, z]| ring(at(x, 0.0, z), COLUMN[COLUMN.len() - 1].into(), COLUMN_SEGMENTS))
            .collect();
        let ceiling = [at(0.0, HEIGHT, 0.0), at(WIDTH, HEIGHT, 0.0), at(WIDTH, HEIGHT, DEPTH), at(0.0, HEIGHT, DEPTH)];
        self.mesh.polygon_with_holes(&ceiling, &capitals, plaster);

        // Walls at x = 0 and z = 0 are whole.
        self.mesh
            .polygon(&[at(0.0, 0.0, 0.0), at(0.0, HEIGHT, 0.0), at(0.0, HEIGHT, DEPTH), at(0.0, 0.0, DEPTH)], teal);
        self.mesh
            .polygon(&[at(0.0, 0.0, 0.0), at(WIDTH, 0.0, 0.0), at(WIDTH, HEIGHT, 0.0), at(0.0, HEIGHT, 0.0)], plaster);
        let wall = [
            at(WIDTH, 0.0, 0.0),
            at(WIDTH, 0.0, door_low),
            at(WIDTH, door_top, door_low),
            at(WIDTH, door_top, door_high),
            at(WIDTH, 0.0, door_high),
            at(WIDTH, 0.0, DEPTH),
            at(WIDTH, HEIGHT, DEPTH),
            at(WIDTH, HEIGHT, 0.0),
        ];
        self.mesh.polygon(&wall, ochre);
        self.reveal(&[wall[4], wall[3], wall[2], wall[1]], Vec3::X * (OUTSIDE_X - WIDTH), false);

        let [low, high] = WINDOW;
        let window =
            [at(low.x, low.y, DEPTH), at(low.x, high.y, DEPTH), at(high.x, high.y, DEPTH), at(high.x, low.y, DEPTH)];
        let wall = [at(WIDTH, 0.0, DEPTH), at(0.0, 0.0, DEPTH), at(0.0, HEIGHT, DEPTH), at(WIDTH, HEIGHT, DEPTH)];
        self.mesh.polygon_with_holes(&wall, &[window.to_vec()], plaster);
        self.reveal(&window, Vec3::Z * (OUTSIDE_Z - DEPTH), true);
    }

    /// The sides of an opening of depth `outward`; its `outline` runs counter-clockwise as seen from inside the room.
    fn reveal(&mut self, outline: &[Vec3], outward: Vec3, closed: bool) {
        let sides = if closed { outline.len() } else { outline.len() - 1 };
        for i in 0..sides {
            let (a, b) = (outline[i], outline[(i + 1) % outline.len()]);
            self.mesh.polygon(&[a, b, b + outward, a + outward], self.palette.plaster);
        }
    }
}
