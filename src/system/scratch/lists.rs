//! Lists that one pass writes and the next pass reads, in memory or in a scratch file.

use std::borrow::Cow;
use std::io;
use std::ops::Range;
use std::path::Path;

use bytemuck::{Pod, cast_slice, cast_slice_mut};

use super::Scratch;

/// Lists that are written once, and read by index.
#[derive(Debug)]
pub struct Lists<T> {
    /// Byte offset of each list in the file, and its number of items.
    index: Vec<(u64, usize)>,
    store: ListStore<T>,
    bytes: u64,
}

#[derive(Debug)]
enum ListStore<T> {
    Memory(Vec<Vec<T>>),
    File(Scratch),
}

impl<T: Pod> Lists<T> {
    /// An empty collection of lists, in memory.
    pub fn in_memory() -> Self {
        Self { index: Vec::new(), store: ListStore::Memory(Vec::new()), bytes: 0 }
    }

    /// Total size, in bytes, of all lists, in memory or in the file.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Moves all lists to a scratch file in `folder`. Later lists are added to the same file.
    ///
    /// # Errors
    /// If the file cannot be created or written.
    pub fn move_to_file(&mut self, folder: &Path) -> io::Result<()> {
        let ListStore::Memory(lists) = &mut self.store else { return Ok(()) };
        let lists = std::mem::take(lists);
        let scratch = Scratch::in_folder(folder)?;
        for ((at, _), list) in self.index.iter_mut().zip(lists) {
            *at = scratch.append(cast_slice(&list))?;
        }
        self.store = ListStore::File(scratch);
        Ok(())
    }

    /// Adds a list at the end.
    ///
    /// # Errors
    /// If the scratch file cannot be written.
    pub fn push(&mut self, list: Vec<T>) -> io::Result<()> {
        let len = list.len();
        self.bytes += size_of_val(&list[..]) as u64;
        let at = match &mut self.store {
            ListStore::Memory(lists) => {
                lists.push(list);
                0
            }
            ListStore::File(scratch) => scratch.append(cast_slice(&list))?,
        };
        self.index.push((at, len));
        Ok(())
    }

    /// The number of lists.
    pub fn len(&self) -> usize {
        self.index.len()
    }

    /// Whether there are no lists.
    pub fn is_empty(&self) -> bool {
        self.index.is_empty()
    }

    /// Returns list number `i`.
    ///
    /// # Errors
    /// If the scratch file cannot be read.
    pub fn get(&self, i: usize) -> io::Result<Cow<'_, [T]>> {
        self.items(i, 0..self.index[i].1)
    }

    /// Returns the items `range` of list number `i`.
    ///
    /// # Errors
    /// If the scratch file cannot be read.
    pub fn items(&self, i: usize, range: Range<usize>) -> io::Result<Cow<'_, [T]>> {
        match &self.store {
            ListStore::Memory(lists) => Ok(Cow::Borrowed(&lists[i][range])),
            ListStore::File(scratch) => {
                let mut items = vec![T::zeroed(); range.len()];
                let at = self.index[i].0 + (range.start * size_of::<T>()) as u64;
                scratch.read_at(at, cast_slice_mut(&mut items))?;
                Ok(Cow::Owned(items))
            }
        }
    }
}
