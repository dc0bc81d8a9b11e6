//! Particles in bin order, in memory or in a scratch file.

use std::borrow::Cow;
use std::io;

use glam::IVec3;
use rayon::prelude::*;

use crate::grid::{BIN, FRACTION_BITS, MortonKey};
use crate::system::scratch::Scratch;

use super::slots::{Record, Slots};

/// Number of bits per axis in a packed particle: the bits of its offset in the cell, plus the bits
/// of its cell's coordinate in the bin.
pub const AXIS_BITS: u32 = FRACTION_BITS + BIN.ilog2();
/// Number of bits in a packed particle; the other bits of its 64-bit word are free.
pub const RECORD_BITS: u32 = 3 * AXIS_BITS;

/// Number of bits that a packed particle leaves free in its word.
pub(super) const FREE_BITS: u32 = u64::BITS - RECORD_BITS;

/// Number of bins that are sorted together before they are written back.
const SORTED_AT_ONCE: usize = 256;

/// Particles in bin order.
#[derive(Debug)]
pub struct Bins {
    pub(super) keys: Vec<MortonKey>,
    /// The index of each bin's first particle; the last entry is the number of particles.
    pub(super) first: Vec<usize>,
    /// Number of components of each attribute.
    pub(super) components: Vec<usize>,
    /// For each attribute, the number of particles without a finite value.
    pub(super) without: Vec<usize>,
    pub(super) store: ParticleStore,
}

/// The storage of the particles. The packed particles (`records`) and each attribute are stored
/// separately.
#[derive(Debug)]
pub(super) enum ParticleStore {
    Memory { records: Vec<Record>, attributes: Vec<Vec<f32>> },
    File { scratch: Scratch, records_at: u64, attributes_at: Vec<u64> },
}

/// The indices of at most `most` of the `len` items along the Morton curve, at equal steps. The
/// step is odd, because an even step would be in phase with the turns of the curve.
pub fn equal_steps(len: usize, most: usize) -> impl Iterator<Item = usize> {
    (0..len).step_by(len.div_ceil(most) | 1)
}

/// Bytes of a particle. `components` has the number of components of each attribute.
pub(super) fn tuple_bytes(components: &[usize]) -> usize {
    size_of::<Record>() + size_of::<f32>() * components.iter().sum::<usize>()
}

/// The particles of one bin.
#[derive(Debug)]
pub struct BinContents<'a> {
    records: Cow<'a, [Record]>,
    /// For each attribute, the components of all particles, particle by particle.
    pub attributes: Vec<Cow<'a, [f32]>>,
}

impl BinContents<'_> {
    /// The packed particles. Each word has x in its lowest bits, then y, then z. For each axis, the
    /// lower bits are the offset in the cell, and the upper bits are the cell in the bin.
    pub fn packed(&self) -> &[u64] {
        &self.records
    }

    /// Each particle's cell in the bin (x fastest), and its offset in the cell.
    pub fn particles(&self) -> impl Iterator<Item = (usize, [u32; 3])> + '_ {
        self.records.iter().map(|&record| {
            let (cell, offset) = unpack(record);
            (cell_index(cell), offset)
        })
    }
}

impl Bins {
    /// Makes bins from `slots`, which threads have filled. `first` has the index of each bin's
    /// first particle.
    pub(super) fn of_slots(
        slots: Slots,
        keys: Vec<MortonKey>,
        first: Vec<usize>,
        components: Vec<usize>,
    ) -> Self {
        let (records, attributes) = slots.into_parts();
        let is_lacking = |tuple: &&[f32]| tuple.iter().any(|x| !x.is_finite());
        let without = |(values, &n): (&Vec<f32>, &usize)| {
            values.par_chunks(n.max(1)).filter(is_lacking).count()
        };
        let without = attributes.iter().zip(&components).map(without).collect();
        Self {
            keys,
            first,
            components,
            without,
            store: ParticleStore::Memory { records, attributes },
        }
    }

    /// Bytes that each bin takes in tables until the surface is finished. This size does not depend
    /// on the number of particles in the bin.
    pub const TABLE_BYTES: u64 = 344;

    /// For each attribute, the number of particles without a finite value. The value of such a
    /// particle exceeds the range of f32 or is missing.
    pub fn without(&self) -> &[usize] {
        &self.without
    }

    /// Bytes of a binned particle. `components` has the number of components of each attribute.
    pub fn particle_bytes(components: &[usize]) -> u64 {
        tuple_bytes(components) as u64
    }

    /// The bins with particles, in Morton order.
    pub fn keys(&self) -> &[MortonKey] {
        &self.keys
    }

    /// The number of particles in bin number `bin`.
    pub fn count(&self, bin: usize) -> usize {
        self.first[bin + 1] - self.first[bin]
    }

    /// Sorts the particles of every bin by cell, x fastest, and then by position in the cell, so
    /// that floating-point sums have a fixed order.
    ///
    /// # Errors
    /// If the particles are in a scratch file that cannot be read or written.
    pub fn sorted(mut self) -> io::Result<Self> {
        for bins in (0..self.keys.len()).collect::<Vec<_>>().chunks(SORTED_AT_ONCE) {
            let sorted: Vec<(Vec<Record>, Vec<Vec<f32>>)> =
                bins.par_iter().map(|&bin| self.sorted_bin(bin)).collect::<io::Result<_>>()?;
            for (&bin, (records, attributes)) in bins.iter().zip(&sorted) {
                self.replace(bin, records, attributes)?;
            }
        }
        Ok(self)
    }

    fn sorted_bin(&self, bin: usize) -> io::Result<(Vec<Record>, Vec<Vec<f32>>)> {
        let BinContents { records, attributes } = self.contents(bin)?;
        let mut order: Vec<(u64, u32)> =
            records.iter().map(|&record| cell_first(record)).zip(0..).collect();
        order.sort_unstable();
        let gather = |(values, &n): (&Cow<[f32]>, &usize)| {
            let tuple = |&(_, from): &(u64, u32)| &values[from as usize * n..][..n];
            order.iter().flat_map(tuple).copied().collect()
        };
        let attributes = attributes.iter().zip(&self.components).map(gather).collect();
        Ok((order.iter().map(|&(_, from)| records[from as usize]).collect(), attributes))
    }

    fn replace(
        &mut self,
        bin: usize,
        records: &[Record],
        attributes: &[Vec<f32>],
    ) -> io::Result<()> {
        let range = self.first[bin]..self.first[bin + 1];
        match &mut self.store {
            ParticleStore::Memory { records: to, attributes: all } => {
                to[range.clone()].copy_from_slice(records);
                for ((to, from), n) in all.iter_mut().zip(attributes).zip(&self.components) {
                    to[range.start * n..range.end * n].copy_from_slice(from);
                }
            }
            ParticleStore::File { scratch, records_at, attributes_at } => {
                let first = range.start as u64;
                scratch.write_at(*records_at + 8 * first, bytemuck::cast_slice(records))?;
                for ((at, from), &n) in attributes_at.iter().zip(attributes).zip(&self.components) {
                    scratch.write_at(at + 4 * n as u64 * first, bytemuck::cast_slice(from))?;
                }
            }
        }
        Ok(())
    }

    /// The particles of bin number `bin`, in no particular order unless they were
    /// [sorted](Self::sorted).
    ///
    /// # Errors
    /// If the particles are in a scratch file that cannot be read.
    pub fn contents(&self, bin: usize) -> io::Result<BinContents<'_>> {
        let range = self.first[bin]..self.first[bin + 1];
        match &self.store {
            ParticleStore::Memory { records, attributes } => Ok(BinContents {
                records: Cow::Borrowed(&records[range.clone()]),
                attributes: attributes
                    .iter()
                    .zip(&self.components)
                    .map(|(values, n)| Cow::Borrowed(&values[range.start * n..range.end * n]))
                    .collect(),
            }),
            ParticleStore::File { scratch, records_at, attributes_at } => {
                let mut records = vec![0; range.len()];
                let first = range.start as u64;
                scratch.read_at(records_at + 8 * first, bytemuck::cast_slice_mut(&mut records))?;
                let mut attributes = Vec::new();
                for (at, &n) in attributes_at.iter().zip(&self.components) {
                    let mut values = vec![0_f32; n * range.len()];
                    scratch.read_at(
                        at + 4 * n as u64 * first,
                        bytemuck::cast_slice_mut(&mut values),
                    )?;
                    attributes.push(Cow::Owned(values));
                }
                Ok(BinContents { records: Cow::Owned(records), attributes })
            }
        }
    }
}

/// Packs the low bits of a particle's position, which is given in steps of 1 / `FRACTIONS` of a
/// cell: the cell in the bin, and the offset in the cell.
#[inline(always)]
pub(super) fn pack(steps: [i64; 3]) -> Record {
    let [x, y, z] = steps.map(|s| s as u64 & ((1 << AXIS_BITS) - 1));
    x | y << AXIS_BITS | z << (2 * AXIS_BITS)
}

/// A sort key that orders packed particles by cell first.
fn cell_first(record: Record) -> u64 {
    let (cell, _) = unpack(record);
    (cell_index(cell) as u64) << RECORD_BITS | record
}

/// Unpacks a particle into its cell in the bin and its offset in the cell.
#[inline(always)]
pub fn unpack(record: u64) -> ([usize; 3], [u32; 3]) {
    let axis = [0, 1, 2].map(|a| (record >> (a * AXIS_BITS)) as u32 & ((1 << AXIS_BITS) - 1));
    (
        axis.map(|bits| (bits >> FRACTION_BITS) as usize),
        axis.map(|bits| bits & ((1 << FRACTION_BITS) - 1)),
    )
}

/// Converts the `record` of a particle of `bin` to a grid whose cells are 2^`octaves` times as
/// wide.
pub fn coarsened(record: u64, bin: IVec3, octaves: u32) -> u64 {
    let (cell, offset) = unpack(record);
    pack(std::array::from_fn(|axis| {
        let cell = i64::from(bin[axis] * BIN) + cell[axis] as i64;
        (cell << FRACTION_BITS | i64::from(offset[axis])) >> octaves
    }))
}

/// The number of a cell in its bin, x fastest.
#[inline(always)]
fn cell_index([x, y, z]: [usize; 3]) -> usize {
    let bin = BIN as usize;
    x + bin * (y + bin * z)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_coarsened_record_keeps_the_position() {
        for octaves in 0..7 {
            for (bin, cell, offset) in [
                (IVec3::ZERO, [0, 7, 15], [8191, 0, 5]),
                (IVec3::new(-3, 5, -1), [3, 15, 0], [1, 2, 3]),
            ] {
                let steps: [i64; 3] = std::array::from_fn(|axis| {
                    i64::from(bin[axis] * BIN + cell[axis]) << FRACTION_BITS | offset[axis]
                });
                let expected = pack(steps.map(|step| step.div_euclid(1 << octaves)));
                assert_eq!(coarsened(pack(steps), bin, octaves), expected);
            }
        }
    }

    #[test]
    fn packing_keeps_cell_and_offset_at_both_ends_of_a_bin() {
        for (cell, offset) in [(IVec3::ZERO, [0; 3]), (IVec3::new(-1, 31, -16), [8191, 1, 4096])] {
            let steps = std::array::from_fn(|a| i64::from(cell[a]) << FRACTION_BITS | offset[a]);
            let (local, offsets) = unpack(pack(steps));
            assert_eq!(local, (cell & 15).as_usizevec3().to_array());
            assert_eq!(offsets.map(i64::from), offset);
        }
    }
}
