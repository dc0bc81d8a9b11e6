//! Rust constants that the shaders use. The example `shaders` (`tools/shaders`) prepends them to
//! the WGSL sources.

use crate::brick::vulkan::{ELSEWHERE, NO_BIN, PAGE_WORDS, PROBES, RUN, SETTLED};
use crate::brick::{AXIS_BITS, COORD_BITS, HALVED_BITS, RECORD_BITS};
use crate::field::distance::vulkan::{CUBE_PARTS, CUBE_WORDS};
use crate::field::distance::{BRICK, MOST_APART, ZERO};
use crate::field::indicator::vulkan::{CLOUD_SAMPLES, OCTANT};
use crate::field::indicator::{
    DISTANCE_SCALE, GAIN_BITS, GHOST_LAYER, SHARE_BITS, SQUARE_BITS, THETA_PER_DISTANCE,
};
use crate::field::sheets::{
    BEYOND, BEYOND_IF_FLAT, BITS, BY_RIM, EXP2, FLAT, IMPURE, IMPURE_IF_FLAT, IN_BULK,
    LEAST_WEIGHT, LOG2, LOG2_OF_E, ROUND, THICK, THIN,
};
use crate::grid::units::FULL;
use crate::grid::{BIN, BLOCK, BLOCK_TILES, CELL_LIMIT, FRACTION_BITS, TILE};
use crate::surface::dual_mc::vulkan::{SIGN_TILES, TILE_WORDS};
use crate::surface::stitch::vulkan::{BLOCK_EDGE_TILES, CASE_WORDS, EDGE_BITS, NO_BLOCK};

/// Returns the name, the WGSL type and the value of each constant.
pub fn wgsl_constants() -> Vec<(&'static str, &'static str, i64)> {
    const {
        assert!(
            RECORD_BITS <= 64 && 2 * AXIS_BITS > 32,
            "y lies in both words of a packed particle"
        )
    };
    const { assert!(3 * COORD_BITS < 64 && 2 * COORD_BITS > 32, "y lies in both words of a bin's key") };
    vec![
        ("FULL", "u32", FULL.into()),
        ("DISTANCE_ZERO", "i32", ZERO.into()),
        ("MOST_APART", "i32", MOST_APART.into()),
        ("SHEET_BITS", "u32", BITS.into()),
        ("IN_BULK_BEGIN", "u32", IN_BULK.begin.into()),
        ("IN_BULK_RANGE", "u32", IN_BULK.range.into()),
        ("LEAST_WEIGHT", "u32", LEAST_WEIGHT.into()),
        ("IMPURE_BEGIN", "u32", IMPURE.begin.into()),
        ("IMPURE_RANGE", "u32", IMPURE.range.into()),
        ("FLAT_BEGIN", "u32", FLAT.begin.into()),
        ("FLAT_RANGE", "u32", FLAT.range.into()),
        ("THICK_BEGIN", "u32", THICK.begin.into()),
        ("THICK_RANGE", "u32", THICK.range.into()),
        ("THIN_BEGIN", "u32", THIN.begin.into()),
        ("THIN_RANGE", "u32", THIN.range.into()),
        ("ROUND_BEGIN", "u32", ROUND.begin.into()),
        ("ROUND_RANGE", "u32", ROUND.range.into()),
        ("BEYOND_BEGIN", "u32", BEYOND.begin.into()),
        ("BEYOND_RANGE", "u32", BEYOND.range.into()),
        ("IMPURE_IF_FLAT", "i32", IMPURE_IF_FLAT.into()),
        ("BEYOND_IF_FLAT", "i32", BEYOND_IF_FLAT.into()),
        ("BY_RIM", "i32", BY_RIM.into()),
        ("LOG2_A", "i32", LOG2[0].into()),
        ("LOG2_B", "i32", LOG2[1].into()),
        ("LOG2_C", "i32", LOG2[2].into()),
        ("LOG2_D", "i32", LOG2[3].into()),
        ("EXP2_A", "i32", EXP2[0].into()),
        ("EXP2_B", "i32", EXP2[1].into()),
        ("EXP2_C", "i32", EXP2[2].into()),
        ("LOG2_E", "i32", LOG2_OF_E.into()),
        ("INSIDE_BITS", "u32", BRICK.ilog2().into()),
        ("FRACTION_BITS", "u32", FRACTION_BITS.into()),
        ("AXIS_BITS", "u32", AXIS_BITS.into()),
        ("DISTANCE_SCALE_BITS", "u32", DISTANCE_SCALE.ilog2().into()),
        ("THETA_PER_DISTANCE", "u32", THETA_PER_DISTANCE.into()),
        ("SHARE_BITS", "u32", SHARE_BITS.into()),
        ("GAIN_BITS", "u32", GAIN_BITS.into()),
        ("SQUARE_BITS", "u32", SQUARE_BITS.into()),
        ("GHOST_LAYER", "u32", GHOST_LAYER.into()),
        ("RUN", "u32", RUN.into()),
        ("CLOUD_SAMPLES", "u32", CLOUD_SAMPLES.into()),
        ("HALVED_BITS", "u32", HALVED_BITS.into()),
        ("CUBE_PARTS", "u32", CUBE_PARTS.into()),
        ("CUBE_WORDS", "u32", CUBE_WORDS.into()),
        ("TILE", "u32", TILE.into()),
        ("BIN", "i32", BIN.into()),
        ("BIN_BITS", "u32", BIN.ilog2().into()),
        ("BLOCK", "i32", BLOCK.into()),
        ("OCTANT", "u32", OCTANT.into()),
        ("OCTANT_CELLS", "u32", OCTANT.pow(3).into()),
        ("PAGE_WORDS", "u32", PAGE_WORDS.into()),
        ("SIGN_TILES", "u32", SIGN_TILES.into()),
        ("BLOCK_TILES", "u32", BLOCK_TILES.into()),
        ("TILE_WORDS", "u32", TILE_WORDS.into()),
        ("CELL_LIMIT", "i32", CELL_LIMIT.into()),
        ("COORD_BITS", "u32", COORD_BITS.into()),
        ("PROBES", "u32", PROBES.into()),
        ("SETTLED", "u32", SETTLED.into()),
        ("NO_BIN", "u32", NO_BIN.into()),
        ("ELSEWHERE", "u32", ELSEWHERE.into()),
        ("BLOCK_EDGE_TILES", "u32", BLOCK_EDGE_TILES.into()),
        ("CASE_WORDS", "u32", CASE_WORDS.into()),
        ("EDGE_BITS", "u32", EDGE_BITS.into()),
        ("NO_BLOCK", "u32", NO_BLOCK.into()),
    ]
}
