//! The recipe on the padded blocks of a batch.

use std::collections::VecDeque;
use std::rc::Rc;

use crate::brick::vulkan::{DeviceBlocks, Window};
use crate::grid::CellBox;
use crate::recipe::{Fields, WideFields, walls_at};
use crate::stage::blur::Kernel;
use crate::stage::blur::vulkan::blur;
use crate::stage::detail::vulkan::{lost, raise};
use crate::stage::distance::vulkan::{depths, join, mixed, outlying, quotient, refine, spread};
use crate::stage::distance::{Bulk, Depths, Drops, Gate, Inside};
use crate::units::Isovalue;
use crate::vulkan::{Batch, View, VulkanError};

use super::Kernels;
use super::blocks::Constants;

/// The samples of a batch's blocks; those within `margin` of a block's faces are unknown.
pub struct Padded {
    pub samples: View,
    pub margin: i32,
    /// Number of its [`PaddedBlocks`].
    pub of: usize,
}

/// The blocks of a batch in cells of a width, and buffers for their fields.
pub struct PaddedBlocks {
    pub blocks: DeviceBlocks,
    /// A cell is 2^`level` of the grid's along an axis.
    pub level: u32,
    /// Cells around those that the field is asked for on.
    pub halo: i32,
    /// Bits of the bricks that are inside, if there are such.
    pub marks: View,
    /// Buffers that are not in use.
    pub free: Vec<View>,
}

/// Fields of padded blocks, in as few buffers as they need: one that nobody refers to any more is used again.
pub struct PaddedFields<'a> {
    pub kernels: &'a Kernels,
    pub constants: &'a Constants,
    pub walls: Option<CellBox>,
    pub commands: &'a mut Batch,
    /// In the order in which the recipe asks for samples in them; the last are those of the grid.
    pub grids: Vec<PaddedBlocks>,
    /// Their samples.
    pub gathered: VecDeque<Rc<Padded>>,
}

impl PaddedFields<'_> {
    fn take(&mut self, of: usize) -> View {
        self.grids[of].free.pop().expect("a recipe needs no more fields than there are")
    }

    /// Gives a buffer back, if nobody else refers to it.
    fn give(&mut self, field: Rc<Padded>) {
        if let Some(field) = Rc::into_inner(field) {
            self.grids[field.of].free.push(field.samples);
        }
    }

    fn stage(&mut self, name: &'static str, passes: u64, of: usize) {
        self.commands.stage(name, passes * 8 * u64::from(self.grids[of].blocks.words));
    }

    fn walls(&self, of: usize) -> Option<CellBox> {
        walls_at(self.grids[of].level, self.walls)
    }
}

impl Fields for PaddedFields<'_> {
    type Field = Rc<Padded>;
    type Error = VulkanError;

    fn samples(&mut self, level: u32, halo: i32) -> Result<Rc<Padded>, VulkanError> {
        let field = self.gathered.pop_front().expect("a recipe asks for no more samples than it says");
        let PaddedBlocks { level: known, halo: around, .. } = self.grids[field.of];
        debug_assert_eq!((level, halo), (known, around));
        Ok(field)
    }

    fn blur(&mut self, field: Rc<Padded>, kernel: &Kernel) -> Result<Rc<Padded>, VulkanError> {
        let of = field.of;
        self.stage("blur", 3, of);
        let to = self.take(of);
        let own = Rc::try_unwrap(field);
        let (from, through, margin) = match &own {
            Ok(own) => (&own.samples, own.samples.clone(), own.margin),
            Err(shared) => (&shared.samples, self.take(of), shared.margin),
        };
        let filter = (kernel, &self.constants.weights[kernel]);
        let views = [from, &through, &to];
        let walls = self.walls(of);
        let blocks = &self.grids[of].blocks;
        blur(self.commands, &self.kernels.blur, blocks, filter, walls, margin, views)?;
        self.grids[of].free.push(through);
        Ok(Rc::new(Padded { samples: to, margin: margin + kernel.reach(), of }))
    }

    fn lost(
        &mut self,
        dif: Rc<Padded>,
        smooth: &Rc<Padded>,
        iso: Isovalue,
    ) -> Result<Rc<Padded>, VulkanError> {
        let of = dif.of;
        self.stage("detail", 2, of);
        let kept = self.take(of);
        let views = [&dif.samples, &smooth.samples, &kept];
        lost(self.commands, &self.kernels.lost, &self.grids[of].blocks, iso, views)?;
        self.give(dif);
        Ok(Rc::new(Padded { samples: kept, margin: smooth.margin, of }))
    }

    fn greater(&mut self, field: Rc<Padded>, other: Rc<Padded>) -> Result<Rc<Padded>, VulkanError> {
        let of = field.of;
        self.stage("detail", 2, of);
        let blocks = &self.grids[of].blocks;
        raise(self.commands, &self.kernels.greater, blocks, &other.samples, &field.samples)?;
        Ok(field)
    }

    fn depths(&mut self, by: &Bulk, shares: [Rc<Padded>; 3]) -> Result<Depths<Rc<Padded>>, VulkanError> {
        let of = shares[0].of;
        self.stage("distances", 3, of);
        let margin = shares.iter().map(|share| share.margin).max().unwrap_or(0);
        let [narrow, middle, wide] = shares.map(|share| share.samples.clone());
        let blocks = &self.grids[of].blocks;
        let views = [&narrow, &middle, &wide];
        depths(self.commands, &self.kernels.distance, blocks, by, &self.constants.depths, views)?;
        let padded = |samples| Rc::new(Padded { samples, margin, of });
        Ok(Depths { calm: padded(wide), fine: padded(narrow), apart: padded(middle) })
    }

    fn mixed(
        &mut self,
        by: &Bulk,
        _: &Inside,
        Depths { calm, fine, apart }: Depths<Rc<Padded>>,
        near: &Rc<Padded>,
    ) -> Result<Rc<Padded>, VulkanError> {
        let of = calm.of;
        self.stage("distances", 4, of);
        let views = [&calm.samples, &fine.samples, &apart.samples, &near.samples];
        let PaddedBlocks { blocks, marks, .. } = &self.grids[of];
        mixed(self.commands, &self.kernels.distance, blocks, by, marks, views)?;
        let (samples, margin) = (calm.samples.clone(), apart.margin.max(near.margin));
        self.give(fine);
        self.give(apart);
        Ok(Rc::new(Padded { samples, margin, of }))
    }

    fn outlying(
        &mut self,
        calm: &Rc<Padded>,
        clouds: Rc<Padded>,
        least: u16,
    ) -> Result<Rc<Padded>, VulkanError> {
        let of = calm.of;
        self.stage("distances", 2, of);
        let views = [&calm.samples, &clouds.samples];
        outlying(self.commands, &self.kernels.distance, &self.grids[of].blocks, least, views)?;
        Ok(Rc::new(Padded { samples: clouds.samples.clone(), margin: calm.margin, of }))
    }

    fn spread(&mut self, field: Rc<Padded>, reach: i32) -> Result<Rc<Padded>, VulkanError> {
        let of = field.of;
        self.stage("distances", 3, of);
        let (to, through) = (self.take(of), self.take(of));
        let window = Window { reach, walls: self.walls(of), margin: field.margin };
        let views = [&field.samples, &through, &to];
        spread(self.commands, &self.kernels.distance, &self.grids[of].blocks, window, views)?;
        self.grids[of].free.push(through);
        let margin = field.margin + reach;
        self.give(field);
        Ok(Rc::new(Padded { samples: to, margin, of }))
    }

    /// Nobody looks before all is done.
    fn look(&mut self, _: &WideFields<Rc<Padded>>, _: u32, _: &Gate) -> Result<(), VulkanError> {
        Ok(())
    }

    fn refined(&mut self, wide: Rc<Padded>, level: u32) -> Result<Rc<Padded>, VulkanError> {
        let of = self.grids.len() - 1;
        if wide.of == of {
            return Ok(wide);
        }
        self.stage("distances", 1, of);
        let to = self.take(of);
        let grids = [&self.grids[wide.of].blocks, &self.grids[of].blocks];
        let within = (self.walls, self.grids[of].halo);
        let views = [&wide.samples, &to];
        refine(self.commands, &self.kernels.distance, grids, level, within, views)?;
        self.give(wide);
        Ok(Rc::new(Padded { samples: to, margin: within.1, of }))
    }

    fn narrowed(&mut self, _: &Rc<Padded>, _: u32, _: &Gate) -> bool {
        true
    }

    fn quotient(
        &mut self,
        clouds: Rc<Padded>,
        around: Rc<Padded>,
        bits: u32,
    ) -> Result<Rc<Padded>, VulkanError> {
        let of = clouds.of;
        self.stage("drops", 2, of);
        let views = [&clouds.samples, &around.samples];
        quotient(self.commands, &self.kernels.distance, &self.grids[of].blocks, bits, views)?;
        let margin = around.margin;
        let samples = clouds.samples.clone();
        self.give(around);
        Ok(Rc::new(Padded { samples, margin, of }))
    }

    fn joined(
        &mut self,
        bulk: Rc<Padded>,
        near: Rc<Padded>,
        shares: Rc<Padded>,
        by: (&Drops, &Gate),
    ) -> Result<Rc<Padded>, VulkanError> {
        let of = bulk.of;
        self.stage("drops", 3, of);
        let views = [&bulk.samples, &near.samples, &shares.samples];
        let blocks = &self.grids[of].blocks;
        join(self.commands, &self.kernels.distance, blocks, by, &self.constants.away, views)?;
        Ok(bulk)
    }
}
