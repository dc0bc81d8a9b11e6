//! Clouds of several sizes, octave by octave.

use std::io;
use std::ops::Range;
use std::sync::Arc;

use glam::IVec3;
use rayon::prelude::*;

use crate::brick::{Bins, Block, DifField, PageInfo, PageSamples, Pages, coarsened};
use crate::field::distance::{refined, wide_cells};
use crate::field::indicator::{Amount, CloudWalls, Clouds, SampledDif, WideCells};
use crate::grid::{BIN, CellBox};

use super::{Octaves, SIDE};

/// The particles of one octave, on its grid.
#[derive(Debug)]
pub struct Layer {
    /// The clouds of the particles' volume.
    pub volume: SampledDif,
    /// The clouds of the particles' volume, times the logarithm of their size in the octave.
    pub fraction: SampledDif,
}

/// The clouds of all particles, in octaves from the finest on. A value of this type has a first
/// octave: its methods count this octave as octave 0, and the cells of this octave as the finest.
/// The clouds of finer octaves are nevertheless part of all densities.
#[derive(Debug, Clone)]
pub struct SizedClouds {
    layers: Arc<[Layer]>,
    /// The index of the first octave among all layers.
    first: usize,
}

/// Makes the pages of one octave from bins whose last attributes give the sizes.
pub struct LayerPages<'a> {
    bins: &'a Bins,
    octaves: Octaves,
    octave: usize,
    /// Computes the size of a particle from its attributes.
    size: &'a (dyn Fn(&[f32]) -> f64 + Sync),
    clouds: Clouds,
    /// For each bin of the octave, the range of the bins in `bins` that it contains.
    groups: Vec<Range<usize>>,
}

impl<'a> LayerPages<'a> {
    /// Prepares to make the pages of one octave; `walls` are those of the octave's grid.
    pub fn new(
        bins: &'a Bins,
        octaves: Octaves,
        octave: usize,
        walls: Option<CloudWalls>,
        size: &'a (dyn Fn(&[f32]) -> f64 + Sync),
    ) -> Self {
        let keys = bins.keys();
        let parent = |bin: usize| keys[bin].coord() >> octave as i32;
        let mut groups: Vec<Range<usize>> = Vec::new();
        // In Morton order the bins of a wider bin are consecutive.
        for bin in 0..keys.len() {
            match groups.last_mut().filter(|group| parent(group.start) == parent(bin)) {
                Some(group) => group.end = bin + 1,
                None => groups.push(bin..bin + 1),
            }
        }
        let shape = Octaves::INDICATOR.shape(SIDE);
        // This amount is not used, because each particle has its own amount.
        let clouds = Clouds::new(Amount::of_spacing(1.0), walls, shape);
        Self { bins, octaves, octave, size, clouds, groups }
    }

    /// The number of bins of the octave that may have pages.
    pub fn bins(&self) -> usize {
        self.groups.len()
    }

    /// Makes the pages of the octave's bins `groups`: first the pages of volumes, then those of
    /// fractions.
    ///
    /// # Errors
    /// If particles are in a scratch file that cannot be read.
    pub fn pages(&self, groups: Range<usize>) -> io::Result<(Pages, Pages)> {
        let of_group = |room: &mut Vec<u16>, group: &Range<usize>| self.page(room, group.clone());
        let pages: Vec<_> = self.groups[groups]
            .par_iter()
            .map_init(|| self.clouds.room(), of_group)
            .collect::<io::Result<_>>()?;
        let (volumes, fractions): (Vec<_>, Vec<_>) = pages.into_iter().unzip();
        Ok((volumes.into_iter().flatten().collect(), fractions.into_iter().flatten().collect()))
    }

    fn page(&self, room: &mut [u16], group: Range<usize>) -> io::Result<(FilledPage, FilledPage)> {
        let own: IVec3 = self.bins.keys()[group.start].coord() >> self.octave as i32;
        let (mut volumes, mut fractions) = (Vec::new(), Vec::new());
        for bin in group {
            let contents = self.bins.contents(bin)?;
            let coord = self.bins.keys()[bin].coord();
            // The size of a particle is computed from its last attribute or, if the last two
            // attributes are mass and density, from both.
            let numbers = &contents.attributes[contents.attributes.len().saturating_sub(2)..];
            let number = |at: usize| [0, 1].map(|i| numbers.get(i).map_or(0.0, |all| all[at]));
            // Neighbouring particles often have the same size, so the share of the previous
            // particle is used again.
            let share = |own: &[f32; 2]| self.octaves.share((self.size)(&own[..numbers.len()]));
            let mut last = None;
            for (at, &record) in contents.packed().iter().enumerate() {
                let own = number(at);
                let known = last.filter(|&(other, _)| other == own);
                let (_, share) = *last.insert(known.unwrap_or_else(|| (own, share(&own))));
                if share.octave != self.octave {
                    continue;
                }
                let record = coarsened(record, coord, self.octave as u32);
                volumes.push((record, share.amount));
                if share.fraction > 0 {
                    fractions.push((record, share.fraction));
                }
            }
        }
        let mut page = |particles: &[(u64, u32)]| {
            (!particles.is_empty())
                .then(|| self.clouds.page_of_amounts(room, own, particles))
                .flatten()
        };
        Ok((page(&volumes), page(&fractions)))
    }
}

/// A page, unless it is empty.
type FilledPage = Option<(PageInfo, PageSamples)>;

/// The part of the clouds that is gathered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum CloudPart {
    /// All volume.
    All,
    /// The volume of the octaves above an octave, and the fractions of that octave.
    Above,
}

impl SizedClouds {
    /// Makes clouds from the layers of all octaves, from the finest octave on.
    ///
    /// # Panics
    /// If there are no octaves.
    #[must_use]
    pub fn new(layers: Vec<Layer>) -> Self {
        assert!(!layers.is_empty(), "there are no octaves");
        // Every coarser octave also uses a layer's clouds, in its own wide cells, so the layer
        // needs one more level for each coarser octave.
        let coarser = (0..layers.len() as u32).rev();
        let with_levels = |(layer, coarser): (Layer, u32)| Layer {
            volume: layer.volume.with_more_levels(coarser),
            fraction: layer.fraction.with_more_levels(coarser),
        };
        let layers: Arc<[Layer]> = layers.into_iter().zip(coarser).map(with_levels).collect();
        for layer in &*layers {
            layer.volume.make_levels();
            layer.fraction.make_levels();
        }
        Self { layers, first: 0 }
    }

    /// The samples of all octaves from the finest on: volumes, then fractions.
    pub fn fields(&self) -> impl Iterator<Item = &DifField> {
        self.layers.iter().flat_map(|layer| [&*layer.volume.dif, &*layer.fraction.dif])
    }

    /// Returns the same clouds with another first octave.
    #[must_use]
    pub fn from_octave(&self, octave: usize) -> Self {
        Self { layers: Arc::clone(&self.layers), first: self.first + octave }
    }

    /// Whether octave 0 is the finest of all.
    #[must_use]
    pub fn is_finest(&self) -> bool {
        self.first == 0
    }

    /// The clouds of the particles in one octave.
    #[must_use]
    pub fn octave(&self, octave: usize) -> &SampledDif {
        &self.layers[self.first + octave].volume
    }

    /// The clouds of an octave's particles, each times the logarithm of the particle's size in the
    /// octave; `None` beyond the last octave.
    #[must_use]
    pub fn fractions(&self, octave: usize) -> Option<&SampledDif> {
        self.layers.get(self.first + octave).map(|layer| &layer.fraction)
    }

    /// The number of octaves.
    #[must_use]
    pub fn octaves(&self) -> usize {
        self.layers.len() - self.first
    }

    /// The density of all particles, in cells 2^`level` times as wide as those of an octave.
    #[must_use]
    pub fn density(&self, octave: usize, level: u32, cells: CellBox) -> Block {
        self.gathered(octave, level, cells, CloudPart::All)
    }

    /// Whether `octave` or a finer octave may have nonzero samples in `cells`, which are 2^`level`
    /// times as wide as the cells of `octave`.
    #[must_use]
    pub fn may_hold(&self, octave: usize, level: u32, cells: CellBox) -> bool {
        let octave = self.first + octave;
        let wide = octave as u32 + level;
        let near = cells.grown(1, 1);
        (0_u32..).zip(&self.layers[..=octave]).any(|(of, layer)| {
            let field = layer.volume.wide(wide - of);
            near.cubes(BIN).any(|bin| field.has_page(bin))
        })
    }

    /// The part of the density that belongs to octaves above `octave`, according to the particles'
    /// sizes.
    #[must_use]
    pub fn above(&self, octave: usize, level: u32, cells: CellBox) -> Block {
        self.gathered(octave, level, cells, CloudPart::Above)
    }

    fn gathered(&self, octave: usize, level: u32, cells: CellBox, part: CloudPart) -> Block {
        let wanted = self.plateau(level);
        let finest = &self.layers[0].volume.facts;
        let mut sum = Block::zero(cells);
        // A requested cell is as wide as 2^`wide` cells of the finest octave.
        let octave = self.first + octave;
        let wide = octave as u32 + level;
        for (of, layer) in (0_u32..).zip(&*self.layers) {
            let field = match (part, (of as usize).cmp(&octave)) {
                (CloudPart::All, _) | (CloudPart::Above, std::cmp::Ordering::Greater) => {
                    &layer.volume
                }
                (CloudPart::Above, std::cmp::Ordering::Equal) => &layer.fraction,
                (CloudPart::Above, std::cmp::Ordering::Less) => continue,
            };
            if field.dif.infos().is_empty() {
                continue;
            }
            let (block, own) = if let Some(own) = wide.checked_sub(of) {
                (field.wide(own).gather(cells), own)
            } else {
                let finer = of - wide;
                let coarse = wide_cells(finer, cells);
                let coarse = field.dif.gather_mirrored(coarse, finest.mirror(of));
                (refined(&coarse, finer, cells), 0)
            };
            add(&mut sum, &block, wanted / self.plateau(own));
        }
        sum.mirror(finest.mirror(wide));
        sum
    }

    /// The plateau of an octave at a level of its cells, up to a constant factor.
    fn plateau(&self, level: u32) -> f64 {
        let cells = self.layers[0].volume.facts.spacing_cells_or_one();
        let spacing = cells / f64::from(1_u32 << level.min(self.wide_cells().level));
        f64::from(Amount::of_spacing(spacing).steps()) / (spacing * spacing * spacing)
    }

    /// The boxes that can contain a surface, in the finest cells. Around the particles of each
    /// octave, they extend at least `reach` cells of that octave.
    pub fn surface_boxes(&self, reach: i32) -> impl Iterator<Item = CellBox> + '_ {
        (0_u32..).zip(&*self.layers).flat_map(move |(octave, layer)| {
            // Particles whose size is between two octaves also belong to the surface of the coarser
            // octave, which reaches twice as far in these cells.
            let further = if layer.fraction.dif.infos().is_empty() { reach } else { 2 * reach };
            layer
                .volume
                .dif
                .infos()
                .iter()
                .map(move |info| info.full.grown(further + 1, further).in_narrower_cells(octave))
        })
    }

    /// The wide cells of every octave. Their edge, in spacings of the octave, is the same in all
    /// octaves.
    #[must_use]
    pub fn wide_cells(&self) -> WideCells {
        self.layers[0].volume.wide_cells()
    }
}

/// Adds the samples of `block` to `sum`, multiplied by `factor` and rounded. Sums saturate at the
/// maximum sample.
fn add(sum: &mut Block, block: &Block, factor: f64) {
    const BITS: u32 = 16;
    let factor = (factor * f64::from(1_u32 << BITS)).round() as u64;
    if factor == 1 << BITS {
        for (to, &sample) in sum.samples_mut().iter_mut().zip(block.samples()) {
            *to = to.saturating_add(sample);
        }
        return;
    }
    for (to, &sample) in sum.samples_mut().iter_mut().zip(block.samples()) {
        let scaled = (u64::from(sample) * factor + (1 << (BITS - 1))) >> BITS;
        *to = (u64::from(*to) + scaled).min(u16::MAX.into()) as u16;
    }
}
