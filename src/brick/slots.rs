//! Slots for particles, filled by several threads.
//!
//! No two threads write the same slot, and all threads are joined before a slot is read, so relaxed
//! atomic accesses are sufficient.

// These are the standard library's atomics, except in a test of all thread interleavings.
use super::atomic::{AtomicU32, AtomicU64, Ordering};
use super::zeroed_in_huge_pages;

/// A packed particle: its position in its bin.
pub(super) type Record = u64;

/// A slot for every particle. Each slot is filled once, by the thread that claimed it.
pub(super) struct Slots {
    records: Vec<AtomicU64>,
    attributes: Vec<Vec<AtomicU32>>,
}

impl Slots {
    /// Creates a slot for each of `particles` particles. `components` has the number of components
    /// of each attribute.
    pub(super) fn new(particles: usize, components: &[usize]) -> Self {
        let attributes = components.iter().map(|n| zeroed_in_huge_pages(particles * n)).collect();
        Self { records: zeroed_in_huge_pages(particles), attributes }
    }

    /// Puts a particle into its slot.
    #[inline(always)]
    pub(super) fn put(&self, slot: usize, record: Record) {
        self.records[slot].store(record, Ordering::Relaxed);
    }

    /// Puts the components of all attributes of a particle, in order, into the particle's slot.
    #[inline(always)]
    pub(super) fn put_attributes(&self, slot: usize, mut values: impl Iterator<Item = f32>) {
        for attribute in &self.attributes {
            let components = attribute.len() / self.records.len();
            let to = &attribute[slot * components..(slot + 1) * components];
            to.iter()
                .zip(values.by_ref())
                .for_each(|(to, x)| to.store(x.to_bits(), Ordering::Relaxed));
        }
    }

    /// Returns the records and the values of each attribute. All threads that fill slots must have
    /// finished.
    pub(super) fn into_parts(self) -> (Vec<Record>, Vec<Vec<f32>>) {
        let plain = |bits: Vec<AtomicU32>| {
            bits.into_iter().map(|x| f32::from_bits(x.into_inner())).collect()
        };
        let records = self.records.into_iter().map(AtomicU64::into_inner).collect();
        (records, self.attributes.into_iter().map(plain).collect())
    }
}
