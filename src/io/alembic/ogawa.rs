//! Ogawa, a container format of groups and data blocks. A group lists the positions of its
//! children, and the header contains the position of the root group.

/// Number of bytes before the first block.
pub const HEADER: u64 = 16;
/// Size, in bytes, of the length that precedes the content of a data block.
pub const LENGTH: u64 = 8;

/// The bit that marks a child as data instead of a group.
const IS_DATA: u64 = 1 << 63;

/// A child of a group: the position of a group or data block, and a bit that distinguishes data
/// from groups. The position is 0 if the child is empty.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OgawaChild(u64);

impl OgawaChild {
    /// A data block without content.
    pub const NO_DATA: Self = Self(IS_DATA);

    /// Byte offset of the group in the file.
    pub fn position(self) -> u64 {
        self.0
    }

    /// The data block at byte `at`.
    pub fn data(at: u64) -> Self {
        Self(IS_DATA | at)
    }
}

/// The header of a complete file. The format version is 1.
pub fn header(root: OgawaChild) -> Vec<u8> {
    let mut header = b"Ogawa\xff\0\x01".to_vec();
    header.extend(root.0.to_le_bytes());
    header
}

/// Encodes groups and small data blocks in order.
pub struct OgawaBlocks {
    /// Byte offset of the first group or block in the file.
    at: u64,
    bytes: Vec<u8>,
}

impl OgawaBlocks {
    pub fn new(at: u64) -> Self {
        Self { at, bytes: Vec::new() }
    }

    pub fn data(&mut self, content: &[u8]) -> OgawaChild {
        if content.is_empty() {
            return OgawaChild::NO_DATA;
        }
        let at = self.end();
        self.bytes.extend((content.len() as u64).to_le_bytes());
        self.bytes.extend(content);
        OgawaChild::data(at)
    }

    pub fn group(&mut self, children: &[OgawaChild]) -> OgawaChild {
        // A group without children is not stored. Its position is 0.
        if children.is_empty() {
            return OgawaChild(0);
        }
        let at = self.end();
        self.bytes.extend((children.len() as u64).to_le_bytes());
        self.bytes.extend(children.iter().flat_map(|child| child.0.to_le_bytes()));
        OgawaChild(at)
    }

    fn end(&self) -> u64 {
        self.at + self.bytes.len() as u64
    }

    pub fn finish(self) -> Vec<u8> {
        self.bytes
    }
}
