//! The samples of a page in memory. If the bin is a single brick and few of its samples are
//! nonzero, as in spray, only the nonzero samples are stored.

use std::borrow::Cow;

use glam::IVec3;

use super::{BrickSide, PageShape};

/// Samples are stored sparsely, with their places, if at most one in `SPARSE_ONE_IN` is nonzero.
const SPARSE_ONE_IN: usize = 8;

/// Number of bits for each coordinate in a [`SamplePlace`].
const PLACE_BITS: u32 = 5;

/// The stored samples of a page.
#[derive(Debug, Clone)]
pub enum PageSamples {
    /// All samples, brick after brick, x fastest in each.
    Dense(Box<[u16]>),
    /// The nonzero samples of a bin that is a single brick, with their places, in any order.
    Sparse(Box<[(SamplePlace, u16)]>),
}

/// The coordinates of a sample in the only brick of its bin, x in the lowest bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SamplePlace(u16);

impl SamplePlace {
    fn of(index: usize, edge: usize) -> Self {
        Self::at([index % edge, index / edge % edge, index / (edge * edge)])
    }

    #[inline]
    fn at([x, y, z]: [usize; 3]) -> Self {
        Self((x | y << PLACE_BITS | z << (2 * PLACE_BITS)) as u16)
    }

    /// The coordinates relative to the brick's lowest sample.
    #[inline]
    pub(super) fn local(self) -> IVec3 {
        IVec3::from(
            [0, 1, 2]
                .map(|axis| i32::from(self.0 >> (axis * PLACE_BITS)) & ((1 << PLACE_BITS) - 1)),
        )
    }

    fn index(self, edge: usize) -> usize {
        let local = self.local().as_usizevec3();
        local.x + edge * (local.y + edge * local.z)
    }
}

impl PageSamples {
    /// Whether `nonzero` samples are few enough to be stored sparsely.
    pub fn are_sparse(nonzero: usize, shape: PageShape) -> bool {
        shape.side == BrickSide::Sixteen && nonzero <= shape.brick_samples() / SPARSE_ONE_IN
    }

    /// Keeps all samples of a page, or only the nonzero ones if they are few.
    pub fn new(samples: Cow<'_, [u16]>, shape: PageShape) -> Self {
        if shape.side != BrickSide::Sixteen {
            return Self::Dense(samples.into_owned().into());
        }
        let nonzero = usize::from(samples.iter().map(|&sample| u16::from(sample > 0)).sum::<u16>());
        if !Self::are_sparse(nonzero, shape) {
            return Self::Dense(samples.into_owned().into());
        }
        let edge = shape.edge() as usize;
        let mut sparse = Vec::with_capacity(nonzero);
        // Zeros are skipped 16 at a time.
        let (many, rest) = samples.as_chunks::<16>();
        for (first, samples) in
            (0..).step_by(16).zip(many.iter().map(|many| &many[..]).chain([rest]))
        {
            if samples.iter().fold(0, |any, sample| any | sample) > 0 {
                let samples = (first..).zip(samples).filter(|&(_, &sample)| sample > 0);
                sparse
                    .extend(samples.map(|(index, &sample)| (SamplePlace::of(index, edge), sample)));
            }
        }
        Self::Sparse(sparse.into())
    }

    /// All samples, brick after brick.
    pub fn dense(&self, shape: PageShape) -> Cow<'_, [u16]> {
        match self {
            Self::Dense(samples) => samples.as_ref().into(),
            Self::Sparse(sparse) => {
                let mut samples = vec![0; shape.brick_samples()];
                let edge = shape.edge() as usize;
                sparse.iter().for_each(|&(place, sample)| samples[place.index(edge)] = sample);
                samples.into()
            }
        }
    }

    /// The samples as words for a file. A dense sample takes one word. A sparse sample takes two
    /// words, its place and its value.
    pub fn to_words(&self) -> Cow<'_, [u16]> {
        match self {
            Self::Dense(samples) => samples.as_ref().into(),
            Self::Sparse(sparse) => {
                sparse.iter().flat_map(|&(place, sample)| [place.0, sample]).collect()
            }
        }
    }

    /// Decodes the words of a page into all of its samples, brick after brick. The words have the
    /// sparse form if there are fewer words than samples.
    ///
    /// # Panics
    /// If the words do not match the shape.
    pub fn dense_of_words(words: Vec<u16>, shape: PageShape) -> Vec<u16> {
        if !Self::are_sparse(words.len() / 2, shape) {
            return words;
        }
        let (pairs, _) = words.as_chunks::<2>();
        let sparse = pairs.iter().map(|&[place, sample]| (SamplePlace(place), sample)).collect();
        Self::Sparse(sparse).dense(shape).into_owned()
    }

    /// Number of bytes that the samples take.
    pub fn bytes(&self) -> usize {
        match self {
            Self::Dense(samples) => size_of_val(&**samples),
            Self::Sparse(sparse) => size_of_val(&**sparse),
        }
    }

    /// Upper bound, in bytes, of the memory for samples in at most `bricks` bricks, if at most
    /// `nonzero` of the samples are nonzero.
    pub fn most_bytes(nonzero: usize, bricks: usize, shape: PageShape) -> usize {
        if Self::are_sparse(nonzero, shape) {
            nonzero * size_of::<(SamplePlace, u16)>()
        } else {
            bricks * shape.brick_samples() * size_of::<u16>()
        }
    }
}

/// Takes the nonzero samples out of the `samples` of a bin with a single brick, and leaves zeros.
/// Every nonzero sample must come from a particle in one of these `cells` of the bin, because
/// samples that are not near these cells are not examined.
pub(super) fn take_sparse(
    samples: &mut [u16],
    cells: impl ExactSizeIterator<Item = [usize; 3]>,
    shape: PageShape,
) -> Box<[(SamplePlace, u16)]> {
    let (edge, reach) = (shape.edge() as usize, 2 * shape.ghost_layer as usize);
    let mut sparse = Vec::with_capacity(shape.cells_per_particle() * cells.len());
    // The brick begins one ghost layer below the bin. Cell (x, y, z) of the bin therefore affects
    // the samples from (x, y, z) of the brick upwards.
    for [x, y, z] in cells {
        for (z, y) in (z..=z + reach).flat_map(|z| (y..=y + reach).map(move |y| (z, y))) {
            let first = x + edge * (y + edge * z);
            for (x, sample) in (x..).zip(&mut samples[first..=first + reach]) {
                if *sample > 0 {
                    sparse.push((SamplePlace::at([x, y, z]), std::mem::take(sample)));
                }
            }
        }
    }
    sparse.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the samples of one-brick bins with and without a ghost layer, with different numbers
    /// of nonzero samples.
    fn scenes() -> impl Iterator<Item = (PageShape, Vec<u16>)> {
        [0, 1].into_iter().flat_map(|ghost_layer| {
            let shape = PageShape { side: BrickSide::Sixteen, ghost_layer };
            let all = shape.brick_samples();
            [0, 1, 5, all / SPARSE_ONE_IN, all / SPARSE_ONE_IN + 1, all].map(|nonzero| {
                let mut samples = vec![0; all];
                // 2731 has no common factor with the number of samples, so all indices are
                // different.
                (0..nonzero).for_each(|i| samples[i * 2731 % all] = (i * 7919 % 65535) as u16 + 1);
                assert_eq!(samples.iter().filter(|&&sample| sample > 0).count(), nonzero);
                (shape, samples)
            })
        })
    }

    #[test]
    fn sparse_samples_round_trip_with_their_places() {
        for (shape, samples) in scenes() {
            let nonzero = samples.iter().filter(|&&sample| sample > 0).count();
            let kept = PageSamples::new(Cow::Borrowed(&samples), shape);
            assert_eq!(
                matches!(kept, PageSamples::Sparse(_)),
                nonzero <= samples.len() / SPARSE_ONE_IN
            );
            assert_eq!(kept.bytes(), PageSamples::most_bytes(nonzero, 1, shape));
            assert_eq!(kept.dense(shape), samples, "{nonzero} of {shape:?}");
            assert_eq!(PageSamples::dense_of_words(kept.to_words().into_owned(), shape), samples);
        }
    }

    #[test]
    fn taking_sparse_samples_around_cells_leaves_zeros() {
        let shape = PageShape { side: BrickSide::Sixteen, ghost_layer: 1 };
        let cells = [[0, 0, 0], [15, 15, 15], [15, 14, 15], [3, 9, 7], [3, 9, 7]];
        let edge = shape.edge() as usize;
        let mut samples = vec![0; shape.brick_samples()];
        for [x, y, z] in cells {
            for (dz, dy) in (0..3).flat_map(|dz| (0..3).map(move |dy| (dz, dy))) {
                let first = x + edge * (y + dy + edge * (z + dz));
                samples[first..first + 2].fill((100 * x + 10 * y + z + 1) as u16);
            }
        }
        let expected = samples.clone();
        let taken = take_sparse(&mut samples, cells.into_iter(), shape);
        assert!(samples.iter().all(|&sample| sample == 0));
        assert_eq!(PageSamples::Sparse(taken).dense(shape), expected);
    }
}
