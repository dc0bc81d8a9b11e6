//! Every shader of `spirv`, and the push constants that each takes.
//!
//! `cargo run --example shaders` writes this file from the WGSL sources, which explain buffers and
//! fields.
#![allow(missing_docs, reason = "the WGSL sources explain them")]

use bytemuck::{Pod, Zeroable};

use crate::vulkan::Shader;

/// Every shader, by name.
pub const SHADERS: [&Shader; 31] = [
    &BASES,
    &BLEND,
    &BLUR,
    &CLOUDS,
    &DEPTHS_OF,
    &EMIT,
    &ENTER,
    &FULL_BRICKS,
    &FULL_CELLS,
    &GATHER,
    &GREATER,
    &HALVE,
    &INDICATE,
    &JOIN,
    &LOOSE,
    &LOST,
    &MIX_BOTH,
    &OUTLYING,
    &PLACE,
    &PROBE,
    &QUOTIENT,
    &REFINE,
    &SETTLE,
    &SHEETS,
    &SIGNS,
    &SORT,
    &SPREAD,
    &STARTS,
    &TILES,
    &TRIANGLES,
    &VERTICES,
];

pub const BASES: Shader = Shader {
    name: "bases",
    code: include_bytes!("../spirv/bases.spv"),
    buffers: &["tallies", "groups"],
    push_bytes: size_of::<BasesPush>() as u32,
    group: 256,
};

pub const BLEND: Shader = Shader {
    name: "blend",
    code: include_bytes!("../spirv/blend.spv"),
    buffers: &["sheets", "certainty", "shares"],
    push_bytes: size_of::<BlendPush>() as u32,
    group: 256,
};

pub const BLUR: Shader = Shader {
    name: "blur",
    code: include_bytes!("../spirv/blur.spv"),
    buffers: &["blocks", "samples", "filtered", "half_weights"],
    push_bytes: size_of::<AxisPush>() as u32,
    group: 256,
};

pub const CLOUDS: Shader = Shader {
    name: "clouds",
    code: include_bytes!("../spirv/clouds.spv"),
    buffers: &["bins", "records", "pages"],
    push_bytes: size_of::<CloudsPush>() as u32,
    group: 256,
};

pub const DEPTHS_OF: Shader = Shader {
    name: "depths_of",
    code: include_bytes!("../spirv/depths_of.spv"),
    buffers: &["narrow", "middle", "wide", "depths"],
    push_bytes: size_of::<DepthsOfPush>() as u32,
    group: 256,
};

pub const EMIT: Shader = Shader {
    name: "emit",
    code: include_bytes!("../spirv/emit.spv"),
    buffers: &["blocks", "field", "signs", "slots", "tallies", "tiles", "ends", "falls"],
    push_bytes: size_of::<EmitPush>() as u32,
    group: 64,
};

pub const ENTER: Shader = Shader {
    name: "enter",
    code: include_bytes!("../spirv/enter.spv"),
    buffers: &["keys", "slots", "census", "homes"],
    push_bytes: size_of::<EnterPush>() as u32,
    group: 256,
};

pub const FULL_BRICKS: Shader = Shader {
    name: "full_bricks",
    code: include_bytes!("../spirv/full_bricks.spv"),
    buffers: &["blocks", "field", "bricks"],
    push_bytes: size_of::<FullBricksPush>() as u32,
    group: 256,
};

pub const FULL_CELLS: Shader = Shader {
    name: "full_cells",
    code: include_bytes!("../spirv/full_cells.spv"),
    buffers: &["pages", "found"],
    push_bytes: size_of::<FullCellsPush>() as u32,
    group: 256,
};

pub const GATHER: Shader = Shader {
    name: "gather",
    code: include_bytes!("../spirv/gather.spv"),
    buffers: &["blocks", "tables", "pages", "theta", "field"],
    push_bytes: size_of::<GatherPush>() as u32,
    group: 256,
};

pub const GREATER: Shader = Shader {
    name: "greater",
    code: include_bytes!("../spirv/greater.spv"),
    buffers: &["other", "field"],
    push_bytes: size_of::<GreaterPush>() as u32,
    group: 256,
};

pub const HALVE: Shader = Shader {
    name: "halve",
    code: include_bytes!("../spirv/halve.spv"),
    buffers: &["blocks", "field", "pages"],
    push_bytes: size_of::<HalvePush>() as u32,
    group: 256,
};

pub const INDICATE: Shader = Shader {
    name: "indicate",
    code: include_bytes!("../spirv/indicate.spv"),
    buffers: &["bins", "records", "pages"],
    push_bytes: size_of::<IndicatePush>() as u32,
    group: 256,
};

pub const JOIN: Shader = Shader {
    name: "join",
    code: include_bytes!("../spirv/join.spv"),
    buffers: &["parts", "blocks", "homes", "near", "shares", "away", "certainty", "field"],
    push_bytes: size_of::<JoinPush>() as u32,
    group: 256,
};

pub const LOOSE: Shader = Shader {
    name: "loose",
    code: include_bytes!("../spirv/loose.spv"),
    buffers: &["clouds", "smooth_clouds"],
    push_bytes: size_of::<LoosePush>() as u32,
    group: 256,
};

pub const LOST: Shader = Shader {
    name: "lost",
    code: include_bytes!("../spirv/lost.spv"),
    buffers: &["dif", "smoothed", "kept"],
    push_bytes: size_of::<LostPush>() as u32,
    group: 256,
};

pub const MIX_BOTH: Shader = Shader {
    name: "mix_both",
    code: include_bytes!("../spirv/mix_both.spv"),
    buffers: &["blocks", "calm", "fine", "apart", "near", "marks"],
    push_bytes: size_of::<MixBothPush>() as u32,
    group: 256,
};

pub const OUTLYING: Shader = Shader {
    name: "outlying",
    code: include_bytes!("../spirv/outlying.spv"),
    buffers: &["calm", "fine", "field"],
    push_bytes: size_of::<OutlyingPush>() as u32,
    group: 256,
};

pub const PLACE: Shader = Shader {
    name: "place",
    code: include_bytes!("../spirv/place.spv"),
    buffers: &["grid", "positions", "keys", "packed", "census"],
    push_bytes: size_of::<PlacePush>() as u32,
    group: 256,
};

pub const PROBE: Shader = Shader {
    name: "probe",
    code: include_bytes!("../spirv/probe.spv"),
    buffers: &["blocks", "probes", "bulk", "outlying", "results"],
    push_bytes: size_of::<ProbePush>() as u32,
    group: 256,
};

pub const QUOTIENT: Shader = Shader {
    name: "quotient",
    code: include_bytes!("../spirv/quotient.spv"),
    buffers: &["around", "field"],
    push_bytes: size_of::<QuotientPush>() as u32,
    group: 256,
};

pub const REFINE: Shader = Shader {
    name: "refine",
    code: include_bytes!("../spirv/refine.spv"),
    buffers: &["blocks", "wide_blocks", "within", "wide", "field"],
    push_bytes: size_of::<RefinePush>() as u32,
    group: 256,
};

pub const SETTLE: Shader = Shader {
    name: "settle",
    code: include_bytes!("../spirv/settle.spv"),
    buffers: &["keys", "slots"],
    push_bytes: size_of::<SettlePush>() as u32,
    group: 256,
};

pub const SHEETS: Shader = Shader {
    name: "sheets",
    code: include_bytes!("../spirv/sheets.spv"),
    buffers: &["blocks", "density", "shares", "certainty"],
    push_bytes: size_of::<SheetsPush>() as u32,
    group: 256,
};

pub const SIGNS: Shader = Shader {
    name: "signs",
    code: include_bytes!("../spirv/signs.spv"),
    buffers: &["blocks", "field", "masks"],
    push_bytes: size_of::<SignsPush>() as u32,
    group: 64,
};

pub const SORT: Shader = Shader {
    name: "sort",
    code: include_bytes!("../spirv/sort.spv"),
    buffers: &["packed", "homes", "places", "records"],
    push_bytes: size_of::<SortPush>() as u32,
    group: 256,
};

pub const SPREAD: Shader = Shader {
    name: "spread",
    code: include_bytes!("../spirv/spread.spv"),
    buffers: &["blocks", "samples", "filtered"],
    push_bytes: size_of::<AxisPush>() as u32,
    group: 256,
};

pub const STARTS: Shader = Shader {
    name: "starts",
    code: include_bytes!("../spirv/starts.spv"),
    buffers: &["blocks", "tiles", "table", "begins"],
    push_bytes: size_of::<StartsPush>() as u32,
    group: 256,
};

pub const TILES: Shader = Shader {
    name: "tiles",
    code: include_bytes!("../spirv/tiles.spv"),
    buffers: &["blocks", "signs", "lengths", "slots", "tallies"],
    push_bytes: 0,
    group: 256,
};

pub const TRIANGLES: Shader = Shader {
    name: "triangles",
    code: include_bytes!("../spirv/triangles.spv"),
    buffers: &["blocks", "tiles", "begins", "table", "indices"],
    push_bytes: size_of::<TrianglesPush>() as u32,
    group: 64,
};

pub const VERTICES: Shader = Shader {
    name: "vertices",
    code: include_bytes!("../spirv/vertices.spv"),
    buffers: &["grid", "blocks", "tiles", "begins", "ends", "positions"],
    push_bytes: size_of::<VerticesPush>() as u32,
    group: 64,
};

#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct AxisPush {
    pub mirror_lo: [i32; 3],
    pub axis: u32,
    pub mirror_hi: [i32; 3],
    pub reach: u32,
    pub margin: [u32; 3],
    pub shift: u32,
}

#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct BasesPush {
    pub blocks: u32,
    pub room: u32,
    pub width: u32,
}

#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct BlendPush {
    pub words: u32,
}

#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct CloudsPush {
    pub walls_lo: [i32; 3],
    pub amount: u32,
    pub walls_hi: [i32; 3],
    pub brick_bits: u32,
    pub gains_lo: [u32; 3],
    pub group_samples: u32,
    pub gains_hi: [u32; 3],
    pub page_words: u32,
}

#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct DepthsOfPush {
    pub words: u32,
    pub scale: u32,
    pub narrow_width: i32,
    pub middle_width: i32,
    pub wide_width: i32,
    pub narrow_most: i32,
    pub middle_most: i32,
    pub wide_most: i32,
    pub fine_share: i32,
    pub calm_share: i32,
}

#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct EmitPush {
    pub mirror_lo: [i32; 3],
    pub blocks: u32,
    pub mirror_hi: [i32; 3],
    pub normals: u32,
}

#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct EnterPush {
    pub count: u32,
    pub mask: u32,
}

#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct FullBricksPush {
    pub width: u32,
    pub least: u32,
}

#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct FullCellsPush {
    pub piece_bits: u32,
    pub ghost_layer: u32,
    pub brick_bits: u32,
    pub page_words: u32,
}

#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct GatherPush {
    pub decode: u32,
    pub brick_bits: u32,
    pub ghost_layer: u32,
    pub page_words: u32,
}

#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct GreaterPush {
    pub words: u32,
}

#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct HalvePush {
    pub mirror_lo: [i32; 3],
    pub factor: u32,
    pub mirror_hi: [i32; 3],
}

#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct IndicatePush {
    pub counting: u32,
}

#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct JoinPush {
    pub begin: u32,
    pub range: u32,
    pub slope: u32,
    pub radius: i32,
    pub width: i32,
    pub earlier: u32,
}

#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct LoosePush {
    pub words: u32,
    pub scale: u32,
}

#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct LostPush {
    pub words: u32,
    pub threshold: u32,
}

#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct MixBothPush {
    pub apart_begin: u32,
    pub apart_range: u32,
    pub apart_slope: u32,
    pub deep_begin: u32,
    pub deep_range: u32,
    pub deep_slope: u32,
}

#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct OutlyingPush {
    pub words: u32,
    pub least: u32,
    pub begin: u32,
    pub begin_of_sheets: u32,
    pub apart_begin: u32,
    pub apart_range: u32,
    pub apart_slope: u32,
}

#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct PlacePush {
    pub first: u32,
    pub count: u32,
    pub width: u32,
    pub chunk: u32,
}

#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct ProbePush {
    pub threshold: u32,
    pub begin: u32,
}

#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct QuotientPush {
    pub words: u32,
    pub bits: u32,
}

#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct RefinePush {
    pub mirror_lo: [i32; 3],
    pub level: u32,
    pub mirror_hi: [i32; 3],
}

#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct SettlePush {
    pub slots: u32,
}

#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct SheetsPush {
    pub mirror_lo: [i32; 3],
    pub step: i32,
    pub mirror_hi: [i32; 3],
    pub slope: i32,
    pub bend: i32,
    pub plateau: i32,
    pub most_more: i32,
    pub sheet_size: i32,
    pub filament_size: i32,
    pub drop_size: i32,
    pub least_size: i32,
    pub rim: i32,
    pub gradual: i32,
    pub by_gradual: i32,
    pub least: i32,
    pub sheet_stretch: i32,
    pub filament_stretch: i32,
    pub share: i32,
    pub by_directions: i32,
    pub by_size: i32,
    pub by_distance: i32,
    pub torn_begin: u32,
    pub torn_range: u32,
}

#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct SignsPush {
    pub walls_lo: [i32; 3],
    pub threshold: u32,
    pub walls_hi: [i32; 3],
}

#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct SortPush {
    pub count: u32,
}

#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct StartsPush {
    pub blocks: u32,
}

#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct TrianglesPush {
    pub first_tile: u32,
    pub tiles: u32,
    pub first_triangle: u32,
    pub first_word: u32,
}

#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct VerticesPush {
    pub first_tile: u32,
    pub tiles: u32,
    pub first_vertex: u32,
    pub first_word: u32,
    pub threshold: u32,
}
