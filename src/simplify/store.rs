//! Lists of triangles between two passes: in memory while they are few, in a scratch file when not.

use std::borrow::Cow;
use std::io;
use std::path::Path;

use crate::scratch::Scratch;

/// Triangles by the numbers of their vertices in the whole mesh.
pub type Triangles = Vec<[u64; 3]>;

/// Lists that are written once and read by number.
#[derive(Debug)]
pub struct Store {
    /// Where each list begins in the file, and its length.
    index: Vec<(u64, usize)>,
    lists: Lists,
    bytes: u64,
}

#[derive(Debug)]
enum Lists {
    Memory(Vec<Triangles>),
    File(Scratch),
}

impl Store {
    /// Nothing yet.
    pub fn in_memory() -> Self {
        Self { index: Vec::new(), lists: Lists::Memory(Vec::new()), bytes: 0 }
    }

    /// Bytes of all lists, in memory or in the file.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// From now on keeps lists in a scratch file in `folder`.
    pub fn move_to_file(&mut self, folder: &Path) -> io::Result<()> {
        let Lists::Memory(lists) = &mut self.lists else { return Ok(()) };
        let lists = std::mem::take(lists);
        let scratch = Scratch::in_folder(folder)?;
        for ((at, _), list) in self.index.iter_mut().zip(lists) {
            *at = scratch.append(bytemuck::cast_slice(&list))?;
        }
        self.lists = Lists::File(scratch);
        Ok(())
    }

    /// Adds a list; its number is that of those before it.
    pub fn push(&mut self, list: Triangles) -> io::Result<()> {
        let len = list.len();
        self.bytes += size_of_val(&list[..]) as u64;
        let at = match &mut self.lists {
            Lists::Memory(lists) => {
                lists.push(list);
                0
            }
            Lists::File(scratch) => scratch.append(bytemuck::cast_slice(&list))?,
        };
        self.index.push((at, len));
        Ok(())
    }

    /// How many lists there are.
    pub fn len(&self) -> usize {
        self.index.len()
    }

    /// List number `i`.
    pub fn get(&self, i: usize) -> io::Result<Cow<'_, [[u64; 3]]>> {
        match &self.lists {
            Lists::Memory(lists) => Ok(Cow::Borrowed(&lists[i])),
            Lists::File(scratch) => {
                let (at, len) = self.index[i];
                let mut list = vec![[0; 3]; len];
                scratch.read_at(at, bytemuck::cast_slice_mut(&mut list))?;
                Ok(Cow::Owned(list))
            }
        }
    }
}
