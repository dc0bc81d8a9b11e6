//! Lookup data for shaders: tables, and the weights of filters.

use hashbrown::{HashMap, HashSet};

use crate::backend::Surfaces;
use crate::field::blur::Weights;
use crate::field::distance::vulkan::tables as tables_of_distances;
use crate::surface::dual_mc::vulkan::lengths;
use crate::vulkan::{Batch, View, VulkanError};

/// Maximum number of cached weights.
const KEPT_WEIGHTS: usize = 64;

/// Lookup data for shaders, which is uploaded at its first use.
#[derive(Debug, Default)]
pub(super) struct Constants {
    tables: Option<Tables>,
    weights: HashMap<Weights, View>,
}

/// Tables that are the same for all frames.
#[derive(Debug, Clone)]
pub(super) struct Tables {
    /// Table of the depth, in multiples of the standard deviation, for each share of the plateau.
    pub(super) depths: View,
    /// Table of the distance from the centre of a drop, in multiples of the drop's standard
    /// deviation, for each share.
    pub(super) away: View,
    /// Table of the number of triangles for each case.
    pub(super) lengths: View,
}

/// The lookup data for the batches of a frame.
pub(super) struct FrameConstants {
    pub(super) tables: Tables,
    pub(super) weights: HashMap<Weights, View>,
    pub(super) theta: View,
    pub(super) decode: u32,
}

impl Constants {
    /// Uploads the lookup data for `surfaces` that the device still lacks. `batch` must be idle.
    pub(super) fn of(
        &mut self,
        surfaces: &Surfaces<'_>,
        batch: &mut Batch,
    ) -> Result<FrameConstants, VulkanError> {
        let Self { tables, weights: known } = self;
        let theta = surfaces.sampled.dif.decode_table().unwrap_or_default();
        let theta: Vec<u32> = theta.iter().map(|&theta| theta.into()).collect();
        let used = surfaces.recipe.filters.weights();
        let unknown: HashSet<&Weights> =
            used.iter().copied().filter(|weights| !known.contains_key(*weights)).collect();
        batch.begin()?;
        let made = match tables {
            Some(tables) => tables.clone(),
            None => {
                let [depths, away] = tables_of_distances().map(|table| batch.store(&table));
                Tables { depths: depths?, away: away?, lengths: batch.store(&lengths())? }
            }
        };
        let new =
            unknown.into_iter().map(|weights| Ok((weights.clone(), batch.store(weights.half())?)));
        let new: Vec<(Weights, View)> = new.collect::<Result<_, VulkanError>>()?;
        let decode = theta.len() as u32;
        let theta = if decode > 0 { batch.store(&theta)? } else { made.lengths.clone() };
        if tables.is_none() || !new.is_empty() || decode > 0 {
            batch.submit(&[])?;
            batch.wait()?;
        }
        // The tables are on the device now, so they can be cached.
        *tables = Some(made.clone());
        if known.len() > KEPT_WEIGHTS {
            known.retain(|weights, _| used.contains(&weights));
        }
        known.extend(new);
        let weights =
            used.into_iter().map(|weights| (weights.clone(), known[weights].clone())).collect();
        Ok(FrameConstants { tables: made, weights, theta, decode })
    }
}
