//! Applies the recipe to the padded blocks of a batch.

use std::collections::VecDeque;
use std::rc::Rc;

use crate::brick::vulkan::{DeviceBlocks, DevicePages, TapWindow, gather};
use crate::field::blur::Weights;
use crate::field::blur::vulkan::blur;
use crate::field::detail::vulkan::{lost, raise};
use crate::field::distance::vulkan::{depths, join, mixed, outlying, quotient, refine, spread};
use crate::field::distance::{Bulk, Depths, Drops, InsideBricks, StandsOut, Width};
use crate::field::recipe::{Fields, ThinShares, WideFields};
use crate::field::sheets::vulkan::{blend, loose, sheets as make_sheets};
use crate::field::sheets::{Loose, SheetFields, Sheets};
use crate::grid::Mirror;
use crate::grid::units::Isovalue;
use crate::vulkan::{Batch, View, VulkanError};

use super::constants::FrameConstants;
use super::pipelines::Pipelines;

/// The samples of a batch's blocks. The samples within `margin` cells of a block's faces are
/// unknown.
pub(super) struct PaddedSamples {
    pub(super) samples: View,
    pub(super) margin: i32,
    /// The index of the [`PaddedBlocks`] to which the samples belong.
    pub(super) grid: usize,
}

/// The blocks of a batch whose cells have the same width, and buffers for their fields.
pub(super) struct PaddedBlocks {
    pub(super) blocks: DeviceBlocks,
    /// The cells are 2^`level` times as wide as the grid's cells.
    pub(super) level: u32,
    /// The bits that mark the inside bricks, if there are any.
    pub(super) marks: Option<View>,
    /// Pairs of an index and a list of block numbers. The index identifies other [`PaddedBlocks`],
    /// whose blocks contain these blocks. For each of these blocks, the list gives the number of
    /// the block that contains it.
    pub(super) within: Vec<(usize, View)>,
    /// Unused buffers.
    pub(super) free: Vec<View>,
}

/// Fields of padded blocks in a minimum number of buffers: a buffer is reused when no field refers
/// to it.
pub(super) struct PaddedFields<'a> {
    pub(super) pipelines: &'a Pipelines,
    pub(super) constants: &'a FrameConstants,
    pub(super) mirror: Option<Mirror>,
    pub(super) commands: &'a mut Batch,
    pub(super) grids: Vec<PaddedBlocks>,
    /// Gathered samples, in the order in which the recipe requests them.
    pub(super) gathered: VecDeque<Rc<PaddedSamples>>,
    /// Index in `grids` of the blocks for which fields are refined.
    pub(super) cells: usize,
    /// Index in `grids` of the parts of these blocks in which particles stand out, if there are
    /// such parts.
    pub(super) parts: Option<usize>,
    /// Index in `grids` of the blocks on which sheets are computed, around `parts`.
    pub(super) drops: usize,
}

impl PaddedFields<'_> {
    /// Gathers the samples of the grid number `grid` from pages. The recipe uses these samples
    /// after the samples of earlier calls.
    pub(super) fn gather(&mut self, grid: usize, pages: &DevicePages) -> Result<(), VulkanError> {
        let samples = self.take_buffer(grid);
        self.commands.stage("gather", pages.pages.bytes() + samples.bytes());
        gather(self.commands, &self.pipelines.gather, &self.grids[grid].blocks, pages, &samples)?;
        self.gathered.push_back(Rc::new(PaddedSamples { samples, margin: 0, grid }));
        Ok(())
    }

    /// Takes an unused buffer for a field on the grid number `grid`.
    fn take_buffer(&mut self, grid: usize) -> View {
        self.grids[grid].free.pop().expect("a recipe needs no more fields than there are")
    }

    /// Marks the buffer of a field as unused, unless there is another reference to the field.
    fn recycle(&mut self, field: Rc<PaddedSamples>) {
        if let Some(field) = Rc::into_inner(field) {
            self.grids[field.grid].free.push(field.samples);
        }
    }

    fn stage(&mut self, name: &'static str, passes: u64, grid: usize) {
        self.commands.stage(name, passes * 8 * u64::from(self.grids[grid].blocks.words));
    }

    fn mirror(&self, grid: usize) -> Option<Mirror> {
        self.mirror.map(|mirror| mirror.in_wider_cells(self.grids[grid].level))
    }

    /// Interpolates the field of another grid for the blocks of the grid number `grid`.
    fn refined_for(
        &mut self,
        wide: Rc<PaddedSamples>,
        grid: usize,
    ) -> Result<Rc<PaddedSamples>, VulkanError> {
        self.stage("distances", 1, grid);
        let to = self.take_buffer(grid);
        let grids = [&self.grids[wide.grid].blocks, &self.grids[grid].blocks];
        let level = self.grids[wide.grid].level - self.grids[grid].level;
        let (within, mirror) = (self.within(grid, wide.grid), self.mirror(wide.grid));
        let views = [&wide.samples, &to];
        refine(self.commands, &self.pipelines.distance, grids, &within, level, mirror, views)?;
        self.recycle(wide);
        Ok(Rc::new(PaddedSamples { samples: to, margin: 0, grid }))
    }

    /// For each block of the grid number `grid`, the number of the block of the grid number `other`
    /// that contains it.
    fn within(&self, grid: usize, other: usize) -> View {
        let mut known = self.grids[grid].within.iter();
        let (_, numbers) = known
            .find(|(known, _)| *known == other)
            .expect("a field is refined from a grid that contains it");
        numbers.clone()
    }
}

impl Fields for PaddedFields<'_> {
    type Field = Rc<PaddedSamples>;
    type Error = VulkanError;

    fn samples(&mut self, level: u32, _: i32) -> Result<Rc<PaddedSamples>, VulkanError> {
        let field = self
            .gathered
            .pop_front()
            .expect("a recipe requests no more samples than were gathered");
        debug_assert_eq!(level, self.grids[field.grid].level);
        Ok(field)
    }

    /// Does not change `clouds`, because only the CPU handles regions near solids.
    fn filled(
        &mut self,
        clouds: &Rc<PaddedSamples>,
        _: u32,
    ) -> Result<Rc<PaddedSamples>, VulkanError> {
        Ok(Rc::clone(clouds))
    }

    fn blur(
        &mut self,
        field: Rc<PaddedSamples>,
        weights: &Weights,
    ) -> Result<Rc<PaddedSamples>, VulkanError> {
        let grid = field.grid;
        self.stage("blur", 3, grid);
        let to = self.take_buffer(grid);
        let own = Rc::try_unwrap(field);
        let (from, temporary, margin) = match &own {
            Ok(own) => (&own.samples, own.samples.clone(), own.margin),
            Err(shared) => (&shared.samples, self.take_buffer(grid), shared.margin),
        };
        let filter = (weights, &self.constants.weights[weights]);
        let views = [from, &temporary, &to];
        let mirror = self.mirror(grid);
        let blocks = &self.grids[grid].blocks;
        blur(self.commands, &self.pipelines.blur, blocks, filter, mirror, margin, views)?;
        self.grids[grid].free.push(temporary);
        Ok(Rc::new(PaddedSamples { samples: to, margin: margin + weights.reach(), grid }))
    }

    fn lost(
        &mut self,
        dif: Rc<PaddedSamples>,
        smooth: &Rc<PaddedSamples>,
        iso: Isovalue,
    ) -> Result<Rc<PaddedSamples>, VulkanError> {
        let grid = dif.grid;
        self.stage("detail", 2, grid);
        let kept = self.take_buffer(grid);
        let views = [&dif.samples, &smooth.samples, &kept];
        lost(self.commands, &self.pipelines.lost, &self.grids[grid].blocks, iso, views)?;
        self.recycle(dif);
        Ok(Rc::new(PaddedSamples { samples: kept, margin: smooth.margin, grid }))
    }

    fn greater(
        &mut self,
        field: Rc<PaddedSamples>,
        other: Rc<PaddedSamples>,
    ) -> Result<Rc<PaddedSamples>, VulkanError> {
        let grid = field.grid;
        self.stage("detail", 2, grid);
        let blocks = &self.grids[grid].blocks;
        raise(self.commands, &self.pipelines.greater, blocks, &other.samples, &field.samples)?;
        Ok(field)
    }

    fn depths(
        &mut self,
        by: &Bulk,
        clouds: Rc<PaddedSamples>,
    ) -> Result<Depths<Rc<PaddedSamples>>, VulkanError> {
        let grid = clouds.grid;
        let mut share = |width: &Width| self.blur(Rc::clone(&clouds), &width.weights);
        let [narrow, middle, wide] = &by.widths;
        let shares = [share(narrow)?, share(middle)?, share(wide)?];
        self.stage("distances", 3, grid);
        let margin = shares.iter().map(|share| share.margin).max().unwrap_or(0);
        let [narrow, middle, wide] = shares.map(|share| share.samples.clone());
        let blocks = &self.grids[grid].blocks;
        let views = [&narrow, &middle, &wide];
        depths(
            self.commands,
            &self.pipelines.distance,
            blocks,
            by,
            &self.constants.tables.depths,
            views,
        )?;
        let padded = |samples| Rc::new(PaddedSamples { samples, margin, grid });
        Ok(Depths { calm: padded(wide), fine: padded(narrow), apart: padded(middle) })
    }

    fn mixed(
        &mut self,
        by: &Bulk,
        _: &InsideBricks,
        Depths { calm, fine, apart }: Depths<Rc<PaddedSamples>>,
        near: &Rc<PaddedSamples>,
    ) -> Result<Rc<PaddedSamples>, VulkanError> {
        let grid = calm.grid;
        self.stage("distances", 4, grid);
        let views = [&calm.samples, &fine.samples, &apart.samples, &near.samples];
        let PaddedBlocks { blocks, marks, .. } = &self.grids[grid];
        let marks = marks.as_ref().expect("blocks of the bulk have marks");
        mixed(self.commands, &self.pipelines.distance, blocks, by, marks, views)?;
        let (samples, margin) = (calm.samples.clone(), apart.margin.max(near.margin));
        self.recycle(fine);
        self.recycle(apart);
        Ok(Rc::new(PaddedSamples { samples, margin, grid }))
    }

    fn outlying(
        &mut self,
        [calm, fine]: [&Rc<PaddedSamples>; 2],
        clouds: Rc<PaddedSamples>,
        by: (u16, &StandsOut),
    ) -> Result<Rc<PaddedSamples>, VulkanError> {
        let grid = calm.grid;
        self.stage("distances", 3, grid);
        let views = [&calm.samples, &fine.samples, &clouds.samples];
        outlying(self.commands, &self.pipelines.distance, &self.grids[grid].blocks, by, views)?;
        Ok(Rc::new(PaddedSamples { samples: clouds.samples.clone(), margin: calm.margin, grid }))
    }

    fn spread(
        &mut self,
        field: Rc<PaddedSamples>,
        reach: i32,
    ) -> Result<Rc<PaddedSamples>, VulkanError> {
        let grid = field.grid;
        self.stage("distances", 3, grid);
        let (to, temporary) = (self.take_buffer(grid), self.take_buffer(grid));
        let window = TapWindow { reach, mirror: self.mirror(grid), margin: field.margin };
        let views = [&field.samples, &temporary, &to];
        spread(self.commands, &self.pipelines.distance, &self.grids[grid].blocks, window, views)?;
        self.grids[grid].free.push(temporary);
        let margin = field.margin + reach;
        self.recycle(field);
        Ok(Rc::new(PaddedSamples { samples: to, margin, grid }))
    }

    /// Does nothing, because the caller has already probed the regions.
    fn probe(
        &mut self,
        _: &WideFields<Rc<PaddedSamples>>,
        _: u32,
        _: u16,
    ) -> Result<(), VulkanError> {
        Ok(())
    }

    fn refined(
        &mut self,
        wide: Rc<PaddedSamples>,
        level: u32,
    ) -> Result<Rc<PaddedSamples>, VulkanError> {
        debug_assert_eq!(level, self.grids[self.cells].level);
        self.refined_for(wide, self.cells)
    }

    /// Restricts later refinements to the parts in which particles stand out, if there are any.
    fn narrowed(&mut self, _: &Rc<PaddedSamples>, _: u32, _: u16) -> bool {
        self.cells = self.parts.unwrap_or(self.cells);
        self.parts.is_some()
    }

    fn quotient(
        &mut self,
        clouds: Rc<PaddedSamples>,
        around: &Weights,
        bits: u32,
    ) -> Result<Rc<PaddedSamples>, VulkanError> {
        let around = self.blur(Rc::clone(&clouds), around)?;
        self.divided(clouds, around, bits)
    }

    fn divided(
        &mut self,
        field: Rc<PaddedSamples>,
        by: Rc<PaddedSamples>,
        bits: u32,
    ) -> Result<Rc<PaddedSamples>, VulkanError> {
        let grid = field.grid;
        self.stage("drops", 2, grid);
        let views = [&field.samples, &by.samples];
        quotient(self.commands, &self.pipelines.distance, &self.grids[grid].blocks, bits, views)?;
        let (samples, margin) = (field.samples.clone(), by.margin);
        self.recycle(by);
        Ok(Rc::new(PaddedSamples { samples, margin, grid }))
    }

    fn may_hold(&mut self, _: &Sheets, _: &Rc<PaddedSamples>) -> bool {
        true
    }

    fn loose(
        &mut self,
        clouds: Rc<PaddedSamples>,
        smooth: Rc<PaddedSamples>,
        scale: u32,
    ) -> Result<Loose<Rc<PaddedSamples>>, VulkanError> {
        let grid = clouds.grid;
        self.stage("sheets", 4, grid);
        let views = [&clouds.samples, &smooth.samples];
        loose(self.commands, &self.pipelines.loose, &self.grids[grid].blocks, scale, views)?;
        let clouds = PaddedSamples { samples: clouds.samples.clone(), margin: smooth.margin, grid };
        Ok(Loose { clouds: Rc::new(clouds), weights: Some(smooth) })
    }

    fn sheets(
        &mut self,
        sheets: &Sheets,
        density: Rc<PaddedSamples>,
        level: u32,
    ) -> Result<Option<SheetFields<Rc<PaddedSamples>>>, VulkanError> {
        let grid = self.drops;
        debug_assert_eq!(level, self.grids[grid].level);
        let density = self.refined_for(density, grid)?;
        self.stage("sheets", 3, grid);
        let numbers = &sheets.numbers;
        let mirror = self.mirror(grid);
        let (shares, certainty) = (self.take_buffer(grid), self.take_buffer(grid));
        let views = [&density.samples, &shares, &certainty];
        let blocks = &self.grids[grid].blocks;
        make_sheets(self.commands, &self.pipelines.sheets, blocks, numbers, mirror, views)?;
        let margin = density.margin + numbers.step;
        self.recycle(density);
        let padded = |samples| Rc::new(PaddedSamples { samples, margin, grid });
        Ok(Some(SheetFields { shares: padded(shares), certainty: padded(certainty) }))
    }

    fn blended(
        &mut self,
        drops: Rc<PaddedSamples>,
        sheets: Rc<PaddedSamples>,
        certainty: &Rc<PaddedSamples>,
    ) -> Result<Rc<PaddedSamples>, VulkanError> {
        let grid = drops.grid;
        self.stage("sheets", 3, grid);
        let views = [&sheets.samples, &certainty.samples, &drops.samples];
        blend(self.commands, &self.pipelines.blend, &self.grids[grid].blocks, views)?;
        let margin = drops.margin.max(certainty.margin);
        let samples = drops.samples.clone();
        self.recycle(sheets);
        Ok(Rc::new(PaddedSamples { samples, margin, grid }))
    }

    fn joined(
        &mut self,
        bulk: Rc<PaddedSamples>,
        near: Rc<PaddedSamples>,
        ThinShares { shares, certainty }: ThinShares<Rc<PaddedSamples>>,
        by: (&Drops, &StandsOut),
    ) -> Result<Rc<PaddedSamples>, VulkanError> {
        self.stage("drops", 3, near.grid);
        let views = [&bulk.samples, &near.samples, &shares.samples];
        let blocks = [near.grid, bulk.grid].map(|grid| &self.grids[grid].blocks);
        let homes = self.within(near.grid, bulk.grid);
        let away = &self.constants.tables.away;
        let certainty = certainty.as_ref().map(|certainty| &certainty.samples);
        let tables = [&homes, away];
        join(self.commands, &self.pipelines.distance, blocks, by, tables, views, certainty)?;
        Ok(bulk)
    }
}
