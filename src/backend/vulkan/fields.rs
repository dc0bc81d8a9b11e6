//! The recipe on the padded blocks of a batch.

use std::rc::Rc;

use hashbrown::HashMap;

use crate::brick::vulkan::{DeviceBlocks, Window};
use crate::grid::CellBox;
use crate::recipe::Fields;
use crate::stage::adaptive::vulkan::{blend, occupancy, spread};
use crate::stage::blur::Kernel;
use crate::stage::blur::vulkan::blur;
use crate::stage::detail::vulkan::{lost, raise};
use crate::units::Isovalue;
use crate::vulkan::{Batch, View, VulkanError};

use super::Kernels;

/// The samples of a batch's blocks; those within `margin` of a block's faces are unknown.
pub struct Padded {
    pub samples: View,
    pub margin: i32,
}

/// Fields of padded blocks, in as few buffers as they need: one that nobody refers to any more is used again.
pub struct PaddedFields<'a> {
    pub kernels: &'a Kernels,
    /// Of every filter in the recipe.
    pub weights: &'a HashMap<Kernel, View>,
    pub walls: Option<CellBox>,
    pub commands: &'a mut Batch,
    pub blocks: &'a DeviceBlocks,
    /// Buffers that are not in use.
    pub free: Vec<View>,
}

impl PaddedFields<'_> {
    fn take(&mut self) -> View {
        self.free.pop().expect("a recipe needs no more fields than there are")
    }

    fn stage(&mut self, name: &'static str, passes: u64) {
        self.commands.stage(name, passes * 8 * u64::from(self.blocks.words));
    }
}

impl Fields for PaddedFields<'_> {
    type Field = Rc<Padded>;
    type Error = VulkanError;

    fn blur(&mut self, field: Rc<Padded>, kernel: &Kernel) -> Result<Rc<Padded>, VulkanError> {
        self.stage("blur", 3);
        let to = self.take();
        let own = Rc::try_unwrap(field);
        let (from, through, margin) = match &own {
            Ok(own) => (&own.samples, own.samples.clone(), own.margin),
            Err(shared) => (&shared.samples, self.take(), shared.margin),
        };
        let filter = (kernel, &self.weights[kernel]);
        let views = [from, &through, &to];
        blur(self.commands, &self.kernels.blur, self.blocks, filter, self.walls, margin, views)?;
        self.free.push(through);
        Ok(Rc::new(Padded { samples: to, margin: margin + kernel.reach() }))
    }

    fn lost(
        &mut self,
        dif: Rc<Padded>,
        smooth: &Rc<Padded>,
        iso: Isovalue,
    ) -> Result<Rc<Padded>, VulkanError> {
        self.stage("detail", 2);
        let kept = self.take();
        let views = [&dif.samples, &smooth.samples, &kept];
        lost(self.commands, &self.kernels.lost, self.blocks, iso, views)?;
        self.free.extend(Rc::into_inner(dif).map(|dif| dif.samples));
        Ok(Rc::new(Padded { samples: kept, margin: smooth.margin }))
    }

    fn greater(&mut self, field: Rc<Padded>, other: Rc<Padded>) -> Result<Rc<Padded>, VulkanError> {
        self.stage("detail", 2);
        raise(self.commands, &self.kernels.greater, self.blocks, &other.samples, &field.samples)?;
        Ok(field)
    }

    fn occupancy(&mut self, dif: Rc<Padded>, least: u16) -> Result<Rc<Padded>, VulkanError> {
        self.stage("detail", 1);
        occupancy(self.commands, &self.kernels.occupancy, self.blocks, least, &dif.samples)?;
        Ok(dif)
    }

    fn spread(&mut self, field: &Rc<Padded>, reach: i32) -> Result<Rc<Padded>, VulkanError> {
        self.stage("detail", 3);
        let (to, through) = (self.take(), self.take());
        let window = Window { reach, walls: self.walls, margin: field.margin };
        let views = [&field.samples, &through, &to];
        spread(self.commands, &self.kernels.spread, self.blocks, window, views)?;
        self.free.push(through);
        Ok(Rc::new(Padded { samples: to, margin: field.margin + reach }))
    }

    fn blend(
        &mut self,
        fine: Rc<Padded>,
        smooth: Rc<Padded>,
        near: Rc<Padded>,
        iso: Isovalue,
    ) -> Result<Rc<Padded>, VulkanError> {
        self.stage("detail", 4);
        let views = [&fine.samples, &smooth.samples, &near.samples];
        blend(self.commands, &self.kernels.blend, self.blocks, iso, views)?;
        Ok(near)
    }
}
