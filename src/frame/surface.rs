//! From a calibrated frame to its surface, block by block, for every method.

use std::io;
use std::sync::Arc;

use glam::IVec3;
use rayon::prelude::*;

use crate::backend::{REGIONS_PER_CALL, Stages, Surfaces};
use crate::brick::{Bins, FrameFacts};
use crate::field::blur::Filter;
use crate::field::blur::Smoothing;
use crate::field::calibration::{CALIBRATING, MeasuredCalibration};
use crate::field::indicator::SampledDif;
use crate::field::recipe::Recipe;
use crate::frame::estimate::{BLOCKS_PER_THREAD, CARRIED_BYTES};
use crate::grid::stretch::Stretch;
use crate::grid::{BLOCK, CellBox, Domain, LevelRegion, MortonKey, PeriodicMesh};
use crate::particles::AttributeInfo;
use crate::surface::attribute::{are_wide, nearest_values, vertex_values};
use crate::surface::dual_mc::{Crossings, Normals, block_vertices};
use crate::surface::mesh::BlockMesh;
use crate::surface::mesh::spool::{Spool, blocks_bytes};
use crate::surface::solid::Solid;
use crate::surface::stitch::StitchedSurface;
use crate::system::control::{Control, Meter, Stage};
use crate::system::timings::Timings;

use super::{FrameError, Resources};

/// Adds data that does not come from the field, such as attributes, to a mesh.
pub(super) type Finish<'a> = dyn Fn(&mut BlockMesh) -> io::Result<()> + Sync + 'a;
/// Takes finished meshes, in the order of their regions.
pub(super) type Push<'a> = dyn FnMut(Vec<BlockMesh>) -> io::Result<()> + 'a;
/// Meshes regions of a field, finishes every mesh, and passes the meshes to a `Push`.
type Contour<'a> =
    dyn Fn(&[LevelRegion], &Meter<'_>, &Finish<'_>, &mut Push<'_>) -> io::Result<()> + Sync + 'a;

/// Meshes regions cube by cube. One thread meshes all regions in a cube with edges of `edge`
/// blocks, and also finishes their meshes. `mesh` makes the meshes and reports the regions to the
/// meter. The same thread meshes and finishes a cube, because sums of a field and sums of
/// attributes use different resources of a core, so they run well side by side.
pub(super) fn cube_by_cube<'a>(
    edge: i32,
    mesh: impl Fn(&[LevelRegion], &Meter<'_>) -> io::Result<Vec<BlockMesh>> + Sync + 'a,
) -> Box<Contour<'a>> {
    Box::new(move |regions, meter, finish, push| {
        // If there are few blocks, each is meshed separately, so that all threads have work.
        let few = (edge * edge * edge) as usize * rayon::current_num_threads();
        let edge = if regions.len() < few { 1 } else { edge };
        let cube = |region: &LevelRegion| {
            (region.level, region.cells.lo.div_euclid(IVec3::splat(edge * BLOCK)))
        };
        let meshes = |regions: &[LevelRegion]| {
            let mut blocks = mesh(regions, meter)?;
            blocks.iter_mut().try_for_each(finish)?;
            Ok::<_, io::Error>(blocks)
        };
        regions.chunks(REGIONS_PER_CALL).try_for_each(|regions| {
            // Regions are in Morton order, so the regions in a cube of blocks are consecutive.
            let cubes: Vec<_> = regions.chunk_by(|a, b| cube(a) == cube(b)).collect();
            let blocks: Vec<_> = cubes.into_par_iter().map(meshes).collect::<io::Result<_>>()?;
            push(blocks.into_iter().flatten().collect())
        })
    })
}

/// A field with everything that is needed to mesh it, whichever method computed the field.
pub(super) struct ExtractableField<'a> {
    /// The parts of blocks that the surface can pass through, in Morton order.
    pub(super) regions: Vec<LevelRegion>,
    pub(super) contour: Box<Contour<'a>>,
    /// The form in which vertices store their positions on their edges.
    pub(super) crossings: Crossings,
    /// For each level of cells, the smoothing of attributes.
    pub(super) attribute_smoothing: Vec<Smoothing>,
    /// The error if there is no surface.
    pub(super) empty_error: FrameError,
}

impl<'a> ExtractableField<'a> {
    /// The field that `recipe` computes from the DIF of a frame.
    pub(super) fn of_dif(
        sampled: &'a SampledDif,
        stages: &'a dyn Stages,
        recipe: Recipe,
        solid: Option<Arc<Solid>>,
        attribute_smoothing: Smoothing,
        normals: Normals,
        periodic_mesh: PeriodicMesh,
    ) -> Self {
        let all =
            Surfaces { sampled, recipe: &recipe, solid: solid.as_deref(), normals, periodic_mesh };
        Self {
            regions: all.regions().into_iter().map(LevelRegion::finest).collect(),
            crossings: recipe.iso.into(),
            empty_error: FrameError::no_surface(&recipe, solid.as_deref()),
            attribute_smoothing: vec![attribute_smoothing],
            contour: Box::new(move |regions, meter, finish, push| {
                let solid = solid.as_deref();
                let surfaces = Surfaces { sampled, recipe: &recipe, solid, normals, periodic_mesh };
                let regions: Vec<CellBox> = regions.iter().map(|region| region.cells).collect();
                stages.contour(&surfaces, &regions, meter, &mut |blocks| {
                    let mut blocks: Vec<_> = blocks.into_iter().flatten().collect();
                    blocks.par_iter_mut().try_for_each(finish)?;
                    push(blocks)
                })
            }),
        }
    }
}

/// A frame with everything that is needed to extract its surface.
pub struct CalibratedFrame<'a> {
    pub(super) facts: &'a FrameFacts,
    pub(super) carried: Option<&'a (Arc<Bins>, Vec<AttributeInfo>)>,
    pub(super) resources: &'a Resources,
    pub(super) control: &'a Control,
    /// Maximum bytes of the surface in memory.
    pub(super) surface_share: u64,
    pub(super) measured: Option<MeasuredCalibration>,
    pub(super) normals: Normals,
    /// The walls at which the mesh ends.
    pub(super) walls: Option<Domain>,
    pub(super) extracted: ExtractableField<'a>,
}

impl<'a> CalibratedFrame<'a> {
    /// The values measured on this frame; `None` if the caller supplied the calibration, or for
    /// kernels.
    pub fn measured(&self) -> Option<MeasuredCalibration> {
        self.measured
    }

    /// The frame's surface.
    ///
    /// # Errors
    /// [`FrameError::NoSurface`], [`FrameError::NoKernelSurface`],
    /// [`FrameError::NoDistanceSurface`], [`FrameError::Scratch`] if scratch files fail, and
    /// [`FrameError::Cancelled`].
    pub fn surface(self, timings: &mut Timings) -> Result<StitchedSurface, FrameError> {
        let facts = self.facts;
        let attributes = self.carried.map_or(Vec::new(), |(_, infos)| infos.clone());
        let spool = self.blocks(timings)?;
        if spool.is_empty() {
            return Err(self.extracted.empty_error);
        }
        Ok(StitchedSurface::new(
            spool,
            facts.grid,
            self.walls,
            self.extracted.crossings,
            attributes,
        ))
    }

    /// The meshes of the blocks that the surface passes through, before they are stitched. There
    /// may be none.
    ///
    /// # Errors
    /// [`FrameError::Scratch`] if scratch files fail.
    pub fn blocks(&self, timings: &mut Timings) -> Result<Spool, FrameError> {
        let infos = self.carried.map_or(&[][..], |(_, infos)| infos);
        let components = infos.iter().map(|info| info.components).collect();
        let mut spool = Spool::in_memory(self.normals == Normals::Gradient, components);
        self.mesh_blocks(&mut spool)?;
        timings.done("mesh");
        Ok(spool)
    }

    /// The blocks that the surface can pass through, in Morton order, each with the number of its
    /// cells that the surface can pass through.
    pub fn passed(&self) -> impl Iterator<Item = (MortonKey, usize)> + '_ {
        self.extracted
            .regions
            .iter()
            .map(|region| (MortonKey::of(region.first_block()), region.cells.volume()))
    }

    /// Restricts the frame to the blocks in a stretch.
    pub fn within(mut self, stretch: Stretch) -> Self {
        self.extracted.regions.retain(|region| {
            let key = MortonKey::of(region.first_block());
            stretch.first <= key && key < stretch.end
        });
        self
    }

    /// Meshes all blocks in Morton order into `spool`, which moves to a scratch file when it
    /// exceeds its share of memory. Each batch has as many blocks as fit into the unused part of
    /// that share, but at least [`BLOCKS_PER_THREAD`] blocks per thread.
    fn mesh_blocks(&self, spool: &mut Spool) -> Result<(), FrameError> {
        let (share, in_scratch) = (self.surface_share, self.resources.scratch_error());
        // Wide attributes need much more memory than the mesh, so they are added after meshing, to a
        // few blocks at a time.
        let wide = are_wide(spool.components().iter().copied());
        let finish = |block: &mut BlockMesh| if wide { Ok(()) } else { self.carry(block) };
        let least = BLOCKS_PER_THREAD * rayon::current_num_threads();
        // Any of these blocks can be full of spray, so this assumes that all of them are.
        let block = blocks_bytes(1, block_vertices(true), spool.vertex_bytes());
        let mut regions = &self.extracted.regions[..];
        let calibrating = if self.measured.is_some() { CALIBRATING } else { 0.0 };
        let meter = self.control.meter(Stage::Meshing, regions.len()).between(calibrating, 1.0);
        meter.go_on()?;
        while !regions.is_empty() {
            let left = share.saturating_sub(spool.bytes_in_memory());
            let fitting = usize::try_from(left / block).unwrap_or(usize::MAX);
            let (batch, later) = regions.split_at(fitting.max(least).min(regions.len()));
            (self.extracted.contour)(batch, &meter, &finish, &mut |blocks| {
                if wide {
                    return self.carry_in_groups(blocks, spool);
                }
                blocks.into_iter().try_for_each(|block| spool.push(block))
            })
            .map_err(&in_scratch)?;
            meter.go_on()?;
            self.move_to_file_if_too_large(spool).map_err(&in_scratch)?;
            regions = later;
        }
        Ok(())
    }

    /// Carries attributes to groups of blocks. Each group fits into [`CARRIED_BYTES`] or is a
    /// single block. Adds the blocks to `spool`, which moves to a scratch file when it exceeds its
    /// share of memory.
    fn carry_in_groups(&self, mut blocks: Vec<BlockMesh>, spool: &mut Spool) -> io::Result<()> {
        while !blocks.is_empty() {
            let mut bytes = 0;
            let fitting = blocks.iter().take_while(|block| {
                bytes += block.ends.len() as u64 * spool.vertex_bytes();
                bytes <= CARRIED_BYTES
            });
            let later = blocks.split_off(fitting.count().max(1));
            blocks.par_iter_mut().try_for_each(|block| self.carry(block))?;
            blocks.into_iter().try_for_each(|block| spool.push(block))?;
            self.move_to_file_if_too_large(spool)?;
            blocks = later;
        }
        Ok(())
    }

    /// Moves `spool` to a scratch file if it exceeds its share of memory.
    fn move_to_file_if_too_large(&self, spool: &mut Spool) -> io::Result<()> {
        if spool.bytes_in_memory() > self.surface_share {
            spool.move_to_file(&self.resources.scratch)?;
        }
        Ok(())
    }

    /// Carries the particles' attributes to the vertices.
    fn carry(&self, mesh: &mut BlockMesh) -> io::Result<()> {
        let Some((bins, infos)) = self.carried else { return Ok(()) };
        let level = mesh.level.level;
        let smoothing = &self.extracted.attribute_smoothing[usize::from(level)];
        let crossings = self.extracted.crossings;
        let mirror = self.facts.mesh_mirror(level.into());
        for (index, info) in infos.iter().enumerate() {
            let attribute = (index, info.components);
            let values = if info.kind.is_whole() {
                nearest_values(bins, attribute, smoothing.halo(), mesh, crossings)
            } else {
                vertex_values(bins, attribute, smoothing, mesh, crossings, mirror)
            };
            mesh.attributes.push(values?);
        }
        Ok(())
    }
}
