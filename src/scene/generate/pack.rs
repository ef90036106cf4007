//! Shelf packing of rectangular cells into a square lightmap.

use glam::Vec2;

/// Texels along the side that cells are laid out for; multiples of it keep cell borders on texel borders.
pub const LIGHTMAP_SIZE: usize = 128;

/// Free texels around each cell: a bilinear lookup on a cell's border reads half a texel beyond it.
const GUTTER: usize = 1;

/// Where a cell lies: whole texels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    pub x: usize,
    pub y: usize,
    pub width: usize,
    pub height: usize,
}

/// Places cells of the given sizes (metres) at the greatest common density at which all fit. None where not even cells
/// of one texel fit.
pub fn pack(sizes: &[Vec2]) -> Option<Vec<Cell>> {
    // Bisect the density, texels per metre, between one that surely fits, if any does, and one that cannot.
    let area: f32 = sizes.iter().map(|s| s.x * s.y).sum();
    let (mut fits, mut too_dense) = (0.0, 2.0 * LIGHTMAP_SIZE as f32 / area.max(f32::MIN_POSITIVE).sqrt());
    let mut best = shelve(sizes, fits)?;
    for _ in 0..20 {
        let density = (fits + too_dense) * 0.5;
        match shelve(sizes, density) {
            Some(cells) => (best, fits) = (cells, density),
            None => too_dense = density,
        }
    }
    Some(best)
}

/// Fills shelves from the tallest cell to the lowest. None where the cells do not fit.
fn shelve(sizes: &[Vec2], texels_per_metre: f32) -> Option<Vec<Cell>> {
    let texels = |metres: f32| ((metres * texels_per_metre).round() as usize).max(1);
    let mut cells: Vec<Cell> =
        sizes.iter().map(|s| Cell { x: 0, y: 0, width: texels(s.x), height: texels(s.y) }).collect();
    let mut order: Vec<usize> = (0..cells.len()).collect();
    order.sort_by_key(|&i| std::cmp::Reverse((cells[i].height, cells[i].width)));
    // Each shelf: its top edge, its height, and how far it is filled.
    let mut shelves: Vec<(usize, usize, usize)> = Vec::new();
    let mut next_y = 0;
    for i in order {
        let (width, height) = (cells[i].width + 2 * GUTTER, cells[i].height + 2 * GUTTER);
        let open = shelves.iter_mut().find(|(_, shelf, x)| height <= *shelf && x + width <= LIGHTMAP_SIZE);
        let (x, y) = match open {
            Some((y, _, x)) => {
                *x += width;
                (*x - width, *y)
            }
            None => {
                if width > LIGHTMAP_SIZE || next_y + height > LIGHTMAP_SIZE {
                    return None;
                }
                shelves.push((next_y, height, width));
                next_y += height;
                (0, next_y - height)
            }
        };
        (cells[i].x, cells[i].y) = (x + GUTTER, y + GUTTER);
    }
    Some(cells)
}
