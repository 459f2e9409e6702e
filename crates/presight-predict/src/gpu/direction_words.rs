//! Maps from direction to pixel for ray tables, packed for `pixel_fit.wgsl` and `direction_map.wgsl`.

use super::layout::{LEVEL_WORDS, MapLevel, MapSide, PIXEL_BOX_WORDS, PackedFit, Params};
use presight_model::error::Result;
use presight_model::sensor::{FitCell, MapCells, PixelBox, RayGrid, TileLookup};

/// Appends the direction cells and their fitted quadratics.
pub(super) fn push_fit(grid: &RayGrid, params: &mut Params, words: &mut Vec<u32>) {
    params.fit_at = words.len() as u32;
    let packed = grid.pixel_fit().cells().iter().map(packed_fit);
    words.extend(packed.flat_map(bytemuck::cast::<PackedFit, [u32; 16]>));
}

fn packed_fit(cell: &FitCell) -> PackedFit {
    let Some([column, row]) = &cell.fitted else {
        return PackedFit { off: if cell.is_empty { [-2.0; 2] } else { [-1.0; 2] }, ..PackedFit::default() };
    };
    let up = |x: f64| (x as f32).next_up();
    PackedFit {
        off: [up(column.off), up(row.off)],
        bend: [up(column.bend), up(row.bend)],
        column: column.terms.map(|t| t as f32),
        row: row.terms.map(|t| t as f32),
    }
}

/// Appends the direction map of a wide view. If all rays look ahead of a plane, levels for small polygons suffice.
///
/// # Errors
/// [`presight_model::ErrorKind::System`] if the system refuses the memory.
pub(super) fn push_map(grid: &RayGrid, params: &mut Params, words: &mut Vec<u32>) -> Result<()> {
    let Some(map) = grid.direction_map() else { return Ok(()) };
    let of_tiles = match grid.view() {
        TileLookup::Ahead(_) => Vec::new(),
        TileLookup::Around(_) => map.levels_of_tiles(grid.tiles())?,
    };
    let levels = || map.levels().iter().chain(&of_tiles);
    params.map_at = words.len() as u32;
    params.map_levels = levels().count() as u32;
    let mut boxes_at = params.map_at + params.map_levels * LEVEL_WORDS;
    for level in levels() {
        let sine = level.half_angle.sin();
        // Rounded down: a cone at the limit uses the next level.
        let sine2 = ((sine * sine) as f32).next_down();
        let packed = MapLevel { sine2, across: level.cells.across, sides: sides(&level.cells, boxes_at) };
        words.extend_from_slice(bytemuck::cast_slice(&[packed]));
        boxes_at += level.cells.boxes.len() as u32 * PIXEL_BOX_WORDS;
    }
    words.extend(levels().flat_map(|level| &level.cells.boxes).flat_map(packed));
    debug_assert_eq!(words.len(), boxes_at as usize);
    Ok(())
}

fn sides(cells: &MapCells, boxes_at: u32) -> [MapSide; 6] {
    cells.sides.map(|side| MapSide {
        first: side.first,
        count: side.count,
        boxes_at: boxes_at + side.start as u32 * PIXEL_BOX_WORDS,
    })
}

fn packed(pixels: &PixelBox) -> [u32; PIXEL_BOX_WORDS as usize] {
    let both = |first: u16, end: u16| u32::from(first) | u32::from(end) << 16;
    [both(pixels.first_row, pixels.end_row), both(pixels.first_column, pixels.end_column)]
}
