//! The stage from regions of blocks to surfaces.

use std::sync::Arc;

use glam::{DVec3, IVec3};
use rayon::prelude::*;

use crate::backend::{Surfaces, Take};
use crate::field::recipe::Filters;
use crate::grid::{BLOCK, BLOCK_TILES, CellBox};
use crate::surface::dual_mc::vulkan::{BlockTally, Falls, Outputs, SIGN_TILES, TileSlot, contour};
use crate::surface::dual_mc::{Crossings, normal};
use crate::surface::mesh::{BlockMesh, Tile};
use crate::system::control::Meter;
use crate::vulkan::{Batch, Buffer, BufferKind, Device, Ticket, View, VulkanError};

use super::bins::DeviceFrameError;
use super::contouring::{BatchField, BlockBatch, Contouring};
use super::fields::PaddedBlocks;
use super::frame::{DeviceFrame, DeviceState};
use super::grids::LevelBlocks;
use super::lane::{BufferLayout, Lane, run_batches};
use super::pipelines::page_bytes;

impl DeviceFrame {
    /// Passes the surfaces of `regions` to `take`, until a failure or until `meter` is cancelled.
    pub(super) fn contour_batches(
        &self,
        state: &mut DeviceState,
        surfaces: &Surfaces<'_>,
        regions: &[CellBox],
        meter: &Meter<'_>,
        take: &mut Take<'_>,
    ) -> Result<(), DeviceFrameError> {
        let goes_on = || meter.goes_on();
        self.each_batch(state, surfaces, regions, &goes_on, &mut |work, lane, batch, begins| {
            let meshes = work.read(lane, batch, begins)?;
            take(meshes).map_err(DeviceFrameError::Host)
        })
    }

    /// Computes the surfaces of `regions` and keeps them on the device.
    pub(super) fn collect_batches(
        &self,
        state: &mut DeviceState,
        surfaces: &Surfaces<'_>,
        regions: &[CellBox],
    ) -> Result<DeviceSurfaces, VulkanError> {
        let (mut tiles, mut ends) = (GrowingBuffer::default(), GrowingBuffer::default());
        let (mut blocks, mut written) = (Vec::new(), None);
        self.each_batch(state, surfaces, regions, &|| true, &mut |_, lane, batch, begins| {
            let totals = begins[batch.meshed.len()];
            if totals.tiles == 0 {
                return Ok(());
            }
            let tile_bytes = u64::from(totals.tiles) * size_of::<Tile>() as u64;
            let end_bytes = u64::from(totals.vertices) * size_of::<[u16; 2]>() as u64;
            lane.download.stage("collect", 2 * (tile_bytes + end_bytes));
            let [new_tiles, new_ends] =
                [lane.existing("tiles", tile_bytes), lane.existing("ends", end_bytes)];
            tiles.append(&self.device, &mut lane.download, &new_tiles)?;
            ends.append(&self.device, &mut lane.download, &new_ends)?;
            written = Some(lane.download.submit(lane.compute.last())?);
            lane.download.wait()?;
            let sizes = begins.windows(2).map(|begins| begins[1].since(&begins[0]));
            let coords = batch.meshed().map(block_of);
            blocks.extend(coords.zip(sizes).filter(|(_, size)| size.tiles > 0));
            Ok::<_, VulkanError>(())
        })?;
        Ok(DeviceSurfaces {
            blocks,
            tiles: tiles.view(&self.device)?,
            ends: ends.view(&self.device)?,
            written,
        })
    }

    /// Computes the surfaces of `regions`, and passes them to `take` batch by batch, in order.
    /// Stops if `take` or the device fails, and starts no more batches once `goes_on` returns
    /// false.
    fn each_batch<E: From<VulkanError>>(
        &self,
        state: &mut DeviceState,
        surfaces: &Surfaces<'_>,
        regions: &[CellBox],
        goes_on: &dyn Fn() -> bool,
        take: &mut TakeBatch<'_, E>,
    ) -> Result<(), E> {
        self.make_lanes(state)?;
        let constants = self.reusable().constants.of(surfaces, &mut state.lanes[0].compute)?;
        let DeviceState { lanes, batch_bytes, .. } = state;
        let residents = self.residents().clone();
        let work = Contouring { frame: self, surfaces, constants, residents, bytes: *batch_bytes };
        let mut next = 0;
        run_batches(
            lanes,
            |lane| {
                if goes_on() { Ok(work.start_next(lane, regions, &mut next)?) } else { Ok(None) }
            },
            |lane, batch| Ok(work.go_on(lane, batch)?),
            |lane, batch| work.finish(lane, batch, take),
        )
    }
}

/// A callback for a batch. Its last argument has, for each block, the tally of all previous blocks
/// of the batch, followed by the totals.
type TakeBatch<'a, E> =
    dyn FnMut(&Contouring<'_>, &mut Lane, &BlockBatch, &[BlockTally]) -> Result<(), E> + 'a;

/// The surfaces of a frame's blocks, on the device.
#[derive(Debug)]
pub struct DeviceSurfaces {
    /// The coordinates and the tally of each block with a surface, in Morton order.
    pub blocks: Vec<(IVec3, BlockTally)>,
    /// The tiles of all blocks, as [`Tile`]s.
    pub tiles: View,
    /// For every vertex, the field at the lower and the upper end of its edge.
    pub ends: View,
    /// The ticket of the copy that completes both buffers; readers wait for it on the device.
    pub(super) written: Option<Ticket>,
}

impl DeviceSurfaces {
    /// Returns the tickets for which commands that read the surfaces must wait.
    pub fn written(&self) -> &[Ticket] {
        self.written.as_slice()
    }
}

/// A device buffer that grows as data is appended.
#[derive(Default)]
struct GrowingBuffer {
    buffer: Option<Arc<Buffer>>,
    used: u64,
}

impl GrowingBuffer {
    /// Records a copy of `from` to the end of the buffer, which grows if necessary.
    fn append(
        &mut self,
        device: &Device,
        commands: &mut Batch,
        from: &View,
    ) -> Result<(), VulkanError> {
        let end = self.used + from.bytes();
        if self.buffer.as_ref().is_none_or(|buffer| buffer.bytes() < end) {
            let doubled = device.buffer(BufferKind::Device, end.max(2 * self.used));
            let larger = doubled.or_else(|_| device.buffer(BufferKind::Device, end))?;
            if let Some(buffer) = self.buffer.replace(Arc::clone(&larger)) {
                commands.copy(&buffer.part(0, self.used), &larger.whole());
            }
        }
        if let Some(buffer) = &self.buffer {
            commands.copy(from, &buffer.part(self.used, from.bytes()));
        }
        self.used = end;
        Ok(())
    }

    /// Returns a view of the used bytes.
    fn view(self, device: &Device) -> Result<View, VulkanError> {
        let buffer = self.buffer.map_or_else(|| device.buffer(BufferKind::Device, 4), Ok)?;
        Ok(buffer.part(0, self.used.max(4)))
    }
}

fn block_of(region: CellBox) -> IVec3 {
    region.lo.div_euclid(IVec3::splat(BLOCK))
}

impl Contouring<'_> {
    /// Starts the next batch of `regions`, if there is one.
    fn start_next(
        &self,
        lane: &mut Lane,
        regions: &[CellBox],
        next: &mut usize,
    ) -> Result<Option<BlockBatch>, VulkanError> {
        let remaining = &regions[*next..];
        if remaining.is_empty() {
            return Ok(None);
        }
        let mut batch = BlockBatch::new(self, remaining);
        *next += batch.regions.len();
        match &self.surfaces.recipe.filters {
            Filters::Paper(_) => self.mesh_regions(lane, &batch)?,
            Filters::Distances(distances) => {
                batch.wide = Some(self.make_wide(lane, &batch.regions, distances)?)
            }
        }
        Ok(Some(batch))
    }

    /// Continues a batch that has wide cells: waits until the wide cells are computed, chooses the
    /// regions to mesh, and meshes them.
    fn go_on(&self, lane: &mut Lane, batch: &mut BlockBatch) -> Result<(), VulkanError> {
        if batch.wide.is_none() {
            return Ok(());
        }
        self.choose(lane, batch)?;
        self.mesh_regions(lane, batch)
    }

    /// Records and submits the commands that compute the surfaces of the regions to mesh.
    pub(super) fn mesh_regions(
        &self,
        lane: &mut Lane,
        batch: &BlockBatch,
    ) -> Result<(), VulkanError> {
        lane.begin()?;
        if batch.meshed.is_empty() {
            return Ok(());
        }
        let outputs = self.outputs(lane, batch.meshed.len() as u64, batch.room)?;
        let read = lane.buffer(
            &self.frame.device,
            "tallies read",
            BufferKind::Download,
            outputs.tallies.bytes(),
        )?;
        let BatchField { blocks, field, uploaded } =
            match (&self.surfaces.recipe.filters, &batch.wide) {
                (Filters::Distances(distances), Some(wide)) => {
                    self.join_wide(lane, batch, distances, wide)?
                }
                _ => self.filter(lane, batch)?,
            };
        let (iso, walls) = (self.surfaces.recipe.iso, self.surfaces.mesh_walls());
        let (commands, pipelines) = (&mut lane.compute, &self.frame.pipelines.dual_mc);
        commands.stage("dual marching cubes", field.bytes());
        contour(commands, pipelines, &blocks, &field, iso, walls, self.has_normals(), &outputs)?;
        commands.copy(&outputs.tallies, &read);
        commands.submit(&[uploaded])?;
        Ok(())
    }

    /// Computes the field on the regions to mesh, with the paper's filters.
    fn filter(&self, lane: &mut Lane, batch: &BlockBatch) -> Result<BatchField, VulkanError> {
        let device = &self.frame.device;
        let [source] = &self.sources()[..] else {
            unreachable!("the paper's filters use cells of one width")
        };
        let from = self.samples(source.level);
        let mut grid = LevelBlocks::default();
        for region in batch.meshed() {
            grid.push_sampled(
                source.cells(self.surfaces.normals.cells(region)),
                region.tiled(),
                from,
                None,
            );
        }
        let mut layout = BufferLayout::default();
        let places = grid.place(&mut layout, page_bytes(from.shape()));
        let staged = lane.buffer(device, "staged", BufferKind::Upload, layout.bytes)?;
        let inputs = lane.buffer(device, "inputs", BufferKind::Device, layout.bytes)?;
        let free = lane.fields(device, "cells", source.fields as usize, grid.field_bytes())?;
        // SAFETY: the lane waited for its earlier work, and only this lane uses the staging buffer.
        unsafe { grid.stage(&staged, &places, from) };
        let uploaded = lane.send(&staged, &inputs)?;

        let blocks = grid.on_device(&inputs, &places);
        let cells = PaddedBlocks {
            blocks: blocks.clone(),
            level: 0,
            marks: None,
            within: Vec::new(),
            free,
        };
        let mut fields = self.fields(&mut lane.compute, vec![cells]);
        fields.gather(0, &places.pages(&inputs, from, Some(&self.constants)))?;
        let field = self.surfaces.recipe.apply(&mut fields)?.samples.clone();
        Ok(BatchField { blocks, field, uploaded })
    }

    fn outputs(&self, lane: &mut Lane, count: u64, room: u64) -> Result<Outputs, VulkanError> {
        let device = &self.frame.device;
        let tiles = count * u64::from(BLOCK_TILES);
        let falls = if self.has_normals() { room * size_of::<Falls>() as u64 } else { 4 };
        Ok(Outputs {
            signs: lane.buffer(
                device,
                "signs",
                BufferKind::Device,
                count * 8 * u64::from(SIGN_TILES),
            )?,
            lengths: self.constants.tables.lengths.clone(),
            slots: lane.buffer(
                device,
                "slots",
                BufferKind::Device,
                tiles * size_of::<TileSlot>() as u64,
            )?,
            tallies: lane.buffer(
                device,
                "tallies",
                BufferKind::Device,
                (count + 1) * size_of::<BlockTally>() as u64,
            )?,
            groups: lane.buffer(device, "groups", BufferKind::Device, 12)?,
            tiles: lane.buffer(
                device,
                "tiles",
                BufferKind::Device,
                tiles * size_of::<Tile>() as u64,
            )?,
            ends: lane.buffer(
                device,
                "ends",
                BufferKind::Device,
                room * size_of::<[u16; 2]>() as u64,
            )?,
            falls: lane.buffer(device, "falls", BufferKind::Device, falls)?,
            room: room as u32,
        })
    }

    /// Waits for a batch, and passes it to `take`. If the batch has more vertices than its buffers
    /// can hold, it is meshed again: with larger buffers if they fit into the memory for a batch,
    /// and otherwise as two smaller batches.
    fn finish<E: From<VulkanError>>(
        &self,
        lane: &mut Lane,
        mut batch: BlockBatch,
        take: &mut TakeBatch<'_, E>,
    ) -> Result<(), E> {
        let count = batch.meshed.len();
        if count == 0 {
            return take(self, lane, &batch, &[BlockTally::default()]);
        }
        lane.compute.wait()?;
        let read = lane.existing("tallies read", ((count + 1) * size_of::<BlockTally>()) as u64);
        // SAFETY: the batch that writes the buffer has finished, and the lane has not begun another
        // batch.
        let begins: Vec<BlockTally> = unsafe { read.read(0, count + 1) };
        let vertices = u64::from(begins[count].vertices);
        if vertices <= batch.room {
            return take(self, lane, &batch, &begins);
        }
        if 2 * vertices * self.vertex_bytes() <= self.bytes {
            batch.room = vertices;
            self.mesh_regions(lane, &batch)?;
            return self.finish(lane, batch, take);
        }
        let (first, second) = batch.regions.split_at(batch.regions.len() / 2);
        for half in [first, second] {
            let mut next = 0;
            while let Some(mut part) = self.start_next(lane, half, &mut next)? {
                self.go_on(lane, &mut part)?;
                self.finish(lane, part, take)?;
            }
        }
        Ok(())
    }

    /// Downloads the surfaces of a batch.
    fn read(
        &self,
        lane: &mut Lane,
        batch: &BlockBatch,
        begins: &[BlockTally],
    ) -> Result<Vec<Option<BlockMesh>>, VulkanError> {
        let device = &self.frame.device;
        let totals = begins[batch.meshed.len()];
        // If the lane has not meshed any regions yet, it has no buffers to read.
        if totals.tiles == 0 {
            return Ok(vec![None; batch.regions.len()]);
        }
        let tile_bytes = u64::from(totals.tiles) * size_of::<Tile>() as u64;
        let end_bytes = u64::from(totals.vertices) * size_of::<[u16; 2]>() as u64;
        let fall_bytes = if self.has_normals() {
            u64::from(totals.vertices) * size_of::<Falls>() as u64
        } else {
            0
        };
        let tiles = lane.buffer(device, "tiles read", BufferKind::Download, tile_bytes)?;
        let ends = lane.buffer(device, "ends read", BufferKind::Download, end_bytes)?;
        let falls = lane.buffer(device, "falls read", BufferKind::Download, fall_bytes)?;
        lane.download.stage("download", 2 * (tile_bytes + end_bytes + fall_bytes));
        for (name, bytes, to) in [
            ("tiles", tile_bytes, &tiles),
            ("ends", end_bytes, &ends),
            ("falls", fall_bytes, &falls),
        ] {
            let from = lane.existing(name, bytes);
            lane.download.copy(&from, to);
        }
        lane.download.submit(lane.compute.last())?;
        lane.download.wait()?;
        let mut meshes = vec![None; batch.regions.len()];
        let meshed = batch.meshed.par_iter().zip(begins.par_windows(2));
        let made: Vec<_> = meshed
            .map(|(&number, begins)| {
                let (begin, size) = (begins[0], begins[1].since(&begins[0]));
                if size.tiles == 0 {
                    return None;
                }
                let vertices = size.vertices as usize;
                let first = u64::from(begin.vertices);
                let first_tile = u64::from(begin.tiles) * size_of::<Tile>() as u64;
                // SAFETY: the copies have finished, and the lane begins nothing before the values
                // are read.
                let (tiles, ends) = unsafe {
                    let ends = ends.read(first * size_of::<[u16; 2]>() as u64, vertices);
                    (tiles.read(first_tile, size.tiles as usize), ends)
                };
                let mut mesh = BlockMesh {
                    block: block_of(batch.regions[number]),
                    tiles,
                    ends,
                    triangle_count: size.triangles as usize,
                    ..BlockMesh::default()
                };
                if self.has_normals() {
                    // SAFETY: the copies have finished, and the lane begins nothing before the
                    // values are read.
                    let falls: Vec<i32> =
                        unsafe { falls.read(first * size_of::<Falls>() as u64, 6 * vertices) };
                    mesh.normals = self.normals(&mesh, &falls);
                }
                Some(mesh)
            })
            .collect();
        batch.meshed.iter().zip(made).for_each(|(&number, mesh)| meshes[number] = mesh);
        Ok(meshes)
    }

    fn normals(&self, mesh: &BlockMesh, falls: &[i32]) -> Vec<[f32; 3]> {
        let falls: &[Falls] = bytemuck::cast_slice(falls);
        let (crossings, walls) =
            (Crossings::from(self.surfaces.recipe.iso), self.surfaces.mesh_walls());
        mesh.edges()
            .zip(&mesh.ends)
            .zip(falls)
            .map(|((edge, &ends), falls)| {
                let falls = falls.map(|axes| DVec3::from(axes.map(f64::from)));
                normal(edge, crossings.fraction(ends), ends[0] > ends[1], falls, walls)
            })
            .collect()
    }
}
