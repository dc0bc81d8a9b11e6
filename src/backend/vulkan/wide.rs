//! The field from distances: first the bulk is computed on wide cells, then the field on the cells
//! of the mesh.
//!
//! Neighbouring regions share wide cells. The device probes the wide cells, so that only regions
//! with a surface are meshed, and drops are computed only in the parts in which particles stand
//! out.

use std::rc::Rc;

use crate::backend::parent;
use crate::field::distance::vulkan::{ProbeResult, RegionProbe, probe};
use crate::field::distance::{DistanceFilters, wide_cells};
use crate::field::recipe::{Filters, WideFields, bulk, joined};
use crate::grid::CellBox;
use crate::surface::dual_mc::dual_cells;
use crate::vulkan::{BufferKind, View, VulkanError};

use super::contouring::{
    BatchField, BlockBatch, Contouring, DROPS_FIELDS, PART_FIELDS, SHEETS_FIELDS, WIDE_FIELDS,
    WideBulk,
};
use super::fields::{PaddedBlocks, PaddedSamples};
use super::grids::{LevelBlocks, NO_TILES};
use super::lane::{BufferLayout, Lane, part};
use super::pipelines::page_bytes;

/// Indices of the block lists of a batch: blocks of wide cells, blocks of the grid's cells, the
/// parts of these blocks in which particles stand out, and the surroundings of these parts for
/// drops and for sheets.
const WIDE: usize = 0;
const CELLS: usize = 1;
const PARTS: usize = 2;
const DROPS: usize = 3;
const SHEETS: usize = 4;

impl Contouring<'_> {
    /// Waits until the wide cells of a batch are computed. Then chooses the regions to mesh, and
    /// finds the part of each region in which particles stand out.
    pub(super) fn choose(
        &self,
        lane: &mut Lane,
        batch: &mut BlockBatch,
    ) -> Result<(), VulkanError> {
        let (Some(wide), Filters::Distances(distances)) =
            (&batch.wide, &self.surfaces.recipe.filters)
        else {
            return Ok(());
        };
        lane.compute.wait()?;
        let count = wide.probes.len();
        let read = lane.existing("probe results read", (size_of::<ProbeResult>() * count) as u64);
        // SAFETY: the batch that writes the buffer has finished, and the lane has not begun another
        // batch.
        let results: Vec<ProbeResult> = unsafe { read.read(0, count) };
        batch.meshed.clear();
        for (number, ((&region, probe), result)) in
            batch.regions.iter().zip(&wide.probes).zip(&results).enumerate()
        {
            let part = probe.outlying(result).map(|wide| {
                // Interpolation spreads the value of a wide cell to the grid cells in the
                // neighbouring wide cells.
                let further = i32::from(distances.level > 0);
                let CellBox { lo, hi } = wide.grown(further, further);
                let near = CellBox { lo: lo << distances.level, hi: hi << distances.level };
                near.intersection(&self.surfaces.normals.cells(region))
            });
            let part = part.filter(|part| !part.is_empty());
            let at_walls =
                self.surfaces.mesh_walls().is_some_and(|walls| !walls.covers(&dual_cells(region)));
            // The field of a cell is a weighted mean of wide cells, to which drops can only add. A
            // region whose wide cells are all inside has a surface only at a wall.
            if (part.is_some() || result.above > 0) && (at_walls || result.below > 0) {
                batch.parts.extend(part.map(|part| (batch.meshed.len(), part)));
                batch.meshed.push(number);
            }
        }
        Ok(())
    }

    /// Computes and probes the bulk on wide cells, which neighbouring regions share.
    pub(super) fn make_wide(
        &self,
        lane: &mut Lane,
        regions: &[CellBox],
        distances: &DistanceFilters,
    ) -> Result<WideBulk, VulkanError> {
        let (device, pipelines) = (&self.frame.device, &self.frame.pipelines.distance);
        let (from, halo) = (self.samples(distances.level), distances.wide_halo());
        let wide = |region| distances.wide_cells(self.surfaces.normals.cells(region));
        let mut grid = LevelBlocks::default();
        let (mut of_regions, mut probes) = (Vec::new(), Vec::new());
        for near in regions.chunk_by(|a, b| parent(a) == parent(b)) {
            let all = near.iter().fold(CellBox::EMPTY, |all, &region| all.union(&wide(region)));
            let volume = |cells: CellBox| cells.grown(halo, halo).volume();
            let shares_block = volume(all) <= near.iter().map(|&region| volume(wide(region))).sum();
            for (i, &region) in near.iter().enumerate() {
                if i == 0 || !shares_block {
                    let cells = if shares_block { all } else { wide(region) };
                    grid.push_sampled(
                        cells.grown(halo, halo),
                        NO_TILES,
                        from,
                        Some(&distances.inside),
                    );
                }
                let block = grid.len() as u32 - 1;
                of_regions.push(block);
                probes.push(RegionProbe::new(wide(region), block));
            }
        }
        let mut layout = BufferLayout::default();
        let places = grid.place(&mut layout, page_bytes(from.shape()));
        let probes_at = layout.place(size_of_val(&probes[..]) as u64);
        lane.begin()?;
        let staged = lane.buffer(device, "staged", BufferKind::Upload, layout.bytes)?;
        let inputs = lane.buffer(device, "wide inputs", BufferKind::Device, layout.bytes)?;
        let free = lane.fields(device, "wide", WIDE_FIELDS, grid.field_bytes())?;
        let result_bytes = (size_of::<ProbeResult>() * probes.len()) as u64;
        let results = lane.buffer(device, "probe results", BufferKind::Device, result_bytes)?;
        let read = lane.buffer(device, "probe results read", BufferKind::Download, result_bytes)?;
        // SAFETY: `begin` waited for the lane's earlier work, and only this lane uses the staging
        // buffer.
        unsafe {
            grid.stage(&staged, &places, from);
            staged.write(probes_at.start, &probes);
        }
        let uploaded = lane.send(&staged, &inputs)?;

        let blocks = grid.on_device(&inputs, &places);
        let marks = Some(places.marks(&inputs));
        let within = Vec::new();
        let grid =
            PaddedBlocks { blocks: blocks.clone(), level: distances.level, marks, within, free };
        let mut fields = self.fields(&mut lane.compute, vec![grid]);
        fields.gather(0, &places.pages(&inputs, from, Some(&self.constants)))?;
        let made = bulk(distances, &mut fields)?;
        let fields =
            WideFields { bulk: made.bulk.samples.clone(), outlying: made.outlying.samples.clone() };
        let views = [&part(&inputs, &probes_at), &fields.bulk, &fields.outlying, &results];
        let commands = &mut lane.compute;
        commands.stage("distances", fields.bulk.bytes() + fields.outlying.bytes());
        let by = (self.surfaces.recipe.iso, distances.stands_out.begin());
        probe(commands, pipelines, &blocks, probes.len() as u32, by, views)?;
        commands.copy(&results, &read);
        commands.submit(&[uploaded])?;
        Ok(WideBulk { blocks, of_regions, probes, fields })
    }

    /// Computes the field on the regions to mesh. The bulk is interpolated from wide cells. Drops
    /// and sheets are added only in the parts of the regions in which particles stand out.
    pub(super) fn join_wide(
        &self,
        lane: &mut Lane,
        batch: &BlockBatch,
        distances: &DistanceFilters,
        wide: &WideBulk,
    ) -> Result<BatchField, VulkanError> {
        let device = &self.frame.device;
        let (level, halo) = (distances.drops_level, distances.drops_halo());
        let (from, from_wide) = (self.samples(level), self.samples(distances.level));
        let [mut cells, mut parts, mut drops, mut sheets] = <[LevelBlocks; 4]>::default();
        for region in batch.meshed() {
            cells.push(self.surfaces.normals.cells(region), region.tiled());
        }
        for &(_, part) in &batch.parts {
            parts.push(part, NO_TILES);
            let around = wide_cells(level, part).grown(halo, halo);
            drops.push_sampled(around, NO_TILES, from, None);
            if distances.sheets.is_some() {
                let halo = distances.sheets_halo();
                let around = distances.wide_cells(part).grown(halo, halo);
                sheets.push_sampled(around, NO_TILES, from_wide, None);
            }
        }
        let of_wide = |number: usize| wide.of_regions[batch.meshed[number]];
        let numbers: [Vec<u32>; 4] = [
            (0..batch.meshed.len()).map(of_wide).collect(),
            batch.parts.iter().map(|&(number, _)| of_wide(number)).collect(),
            batch.parts.iter().map(|&(number, _)| number as u32).collect(),
            (0..batch.parts.len() as u32).collect(),
        ];
        let mut layout = BufferLayout::default();
        let grids = [(&cells, from), (&parts, from), (&drops, from), (&sheets, from_wide)];
        let places = grids.map(|(grid, from)| grid.place(&mut layout, page_bytes(from.shape())));
        let numbers_at =
            numbers.each_ref().map(|numbers| layout.place(size_of_val(&numbers[..]) as u64));
        let staged = lane.buffer(device, "staged", BufferKind::Upload, layout.bytes)?;
        let inputs = lane.buffer(device, "inputs", BufferKind::Device, layout.bytes)?;
        let mut free = Vec::new();
        for (name, count, grid) in [
            ("cells", 1, &cells),
            ("parts", PART_FIELDS, &parts),
            ("drops", DROPS_FIELDS, &drops),
            ("sheets", SHEETS_FIELDS, &sheets),
        ] {
            free.push(lane.fields(device, name, count, grid.field_bytes())?);
        }
        for ((grid, from), places) in grids.into_iter().zip(&places) {
            // SAFETY: the lane waited for the readers of its staging buffer, which no other lane
            // uses.
            unsafe { grid.stage(&staged, places, from) };
        }
        for (numbers, at) in numbers.iter().zip(&numbers_at) {
            // SAFETY: the lane waited for the readers of its staging buffer, which no other lane
            // uses.
            unsafe { staged.write(at.start, numbers) };
        }
        let uploaded = lane.send(&staged, &inputs)?;

        let [wide_of_cells, wide_of_parts, homes, of_parts] =
            numbers_at.each_ref().map(|at| part(&inputs, at));
        let blocks = cells.on_device(&inputs, &places[0]);
        let within = [
            Vec::new(),
            vec![(WIDE, wide_of_cells)],
            vec![(WIDE, wide_of_parts), (CELLS, homes), (DROPS, of_parts.clone())],
            vec![(SHEETS, of_parts)],
            Vec::new(),
        ];
        let all = [wide.blocks.clone(), blocks.clone()].into_iter().chain(
            [(&parts, &places[1]), (&drops, &places[2]), (&sheets, &places[3])]
                .map(|(grid, places)| grid.on_device(&inputs, places)),
        );
        let free = std::iter::once(Vec::new()).chain(free);
        let levels = [distances.level, 0, 0, level, distances.level];
        let grids = all.zip(within).zip(free).zip(levels);
        let padded = |(((blocks, within), free), level)| PaddedBlocks {
            blocks,
            level,
            marks: None,
            within,
            free,
        };
        let mut fields = self.fields(&mut lane.compute, grids.map(padded).collect());
        fields.cells = CELLS;
        if !batch.parts.is_empty() {
            fields.parts = Some(PARTS);
            fields.drops = DROPS;
            if distances.sheets.is_some() {
                let pages = places[3].pages(&inputs, from_wide, Some(&self.constants));
                fields.gather(SHEETS, &pages)?;
            }
            fields.gather(DROPS, &places[2].pages(&inputs, from, Some(&self.constants)))?;
        }
        let known = |samples: &View| {
            Rc::new(PaddedSamples { samples: samples.clone(), margin: 0, grid: WIDE })
        };
        let made =
            WideFields { bulk: known(&wide.fields.bulk), outlying: known(&wide.fields.outlying) };
        let field = joined(distances, &mut fields, made)?.samples.clone();
        Ok(BatchField { blocks, field, uploaded })
    }
}
