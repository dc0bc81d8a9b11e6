//! The structure of a binary layer ("crate", version 0.8.0). Values are followed by tables of
//! tokens, fields, paths and specs. The tables are stored as LZ4 blocks that contain only literals.

/// Number of bytes before the first value.
pub(super) const HEADER: u64 = 88;

/// Type numbers of values and of specs.
pub(super) const INT: u64 = 3;
pub(super) const UINT: u64 = 4;
pub(super) const FLOAT: u64 = 8;
const DOUBLE: u64 = 9;
const TOKEN: u64 = 11;
pub(super) const VEC2F: u64 = 20;
pub(super) const VEC3F: u64 = 24;
pub(super) const VEC4F: u64 = 28;
const TOKEN_VECTOR: u64 = 41;
const SPECIFIER: u64 = 42;
const VARIABILITY: u64 = 44;
const TIME_SAMPLES: u64 = 46;
const DOUBLE_VECTOR: u64 = 48;
const PSEUDO_ROOT: i32 = 7;
const PRIM: i32 = 6;
const ATTRIBUTE: i32 = 1;

/// A value: its type, and either its position in the file or its content.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct UsdValue(u64);

impl UsdValue {
    fn at(kind: u64, offset: u64) -> Self {
        Self(kind << 48 | offset)
    }

    fn inlined(kind: u64, payload: u64) -> Self {
        Self(1 << 62 | kind << 48 | payload)
    }

    /// An array whose length, followed by its values, is stored at byte `offset`. An empty array
    /// has no position.
    pub fn array(kind: u64, offset: u64, length: u64) -> Self {
        Self(1 << 63 | Self::at(kind, if length == 0 { 0 } else { offset }).0)
    }

    /// The specifier `def`, which has the number 0.
    pub fn def() -> Self {
        Self::inlined(SPECIFIER, 0)
    }

    /// The variability `uniform`, which has the number 1.
    pub fn uniform() -> Self {
        Self::inlined(VARIABILITY, 1)
    }

    /// A double that an f32 represents exactly. The format stores it as this f32.
    pub fn double(value: f32) -> Self {
        Self::inlined(DOUBLE, value.to_bits().into())
    }
}

/// The end of a file: all values except arrays, and all tables.
pub(super) struct FileTail {
    /// Byte offset of this part in the file.
    at: u64,
    values: Vec<u8>,
    tokens: Vec<String>,
    fields: Vec<(u32, UsdValue)>,
    /// Indices into `fields`. -1 ends each set of fields.
    field_sets: Vec<i32>,
    /// For each path, the token of its last element (negative for a property), and the jump to the
    /// next path.
    paths: Vec<(i32, i32)>,
    /// For each path, the index of its first field in `field_sets`, and its spec type.
    specs: Vec<(i32, i32)>,
}

impl FileTail {
    pub fn new(at: u64) -> Self {
        Self {
            at,
            values: Vec::new(),
            // In `paths`, a negated token marks a property. 0 cannot be negated, so the root has
            // token 0 and all other elements have greater tokens.
            tokens: vec![String::new()],
            fields: Vec::new(),
            field_sets: Vec::new(),
            paths: Vec::new(),
            specs: Vec::new(),
        }
    }

    fn token_index(&mut self, token: &str) -> u32 {
        let found = self.tokens.iter().position(|known| known == token);
        found.unwrap_or_else(|| {
            self.tokens.push(token.to_owned());
            self.tokens.len() - 1
        }) as u32
    }

    pub fn token(&mut self, token: &str) -> UsdValue {
        UsdValue::inlined(TOKEN, self.token_index(token).into())
    }

    pub fn tokens(&mut self, tokens: &[&str]) -> UsdValue {
        let indices: Vec<u32> = tokens.iter().map(|token| self.token_index(token)).collect();
        let at = self.end();
        self.values.extend((tokens.len() as u64).to_le_bytes());
        self.values.extend(indices.iter().flat_map(|index| index.to_le_bytes()));
        UsdValue::at(TOKEN_VECTOR, at)
    }

    /// Stores `value` as a time sample at time 0.
    pub fn sample(&mut self, value: UsdValue) -> UsdValue {
        let times = self.end();
        self.put(&[1, 0f64.to_bits()]);
        let at = self.end();
        // An offset to the times precedes the times, and an offset to the values precedes the
        // values. Both offsets are 8, because each offset is directly followed by its target.
        self.put(&[8, UsdValue::at(DOUBLE_VECTOR, times).0, 8, 1, value.0]);
        UsdValue::at(TIME_SAMPLES, at)
    }

    fn put(&mut self, words: &[u64]) {
        self.values.extend(words.iter().flat_map(|word| word.to_le_bytes()));
    }

    fn end(&self) -> u64 {
        self.at + self.values.len() as u64
    }

    pub fn root(&mut self, fields: &[(&str, UsdValue)]) {
        self.spec(0, -1, fields, PSEUDO_ROOT);
    }

    /// Adds the prim. Its properties must be added after it.
    pub fn prim(&mut self, name: &str, fields: &[(&str, UsdValue)]) {
        let element = self.token_index(name) as i32;
        self.spec(element, -1, fields, PRIM);
    }

    pub fn property(&mut self, name: &str, fields: &[(&str, UsdValue)]) {
        let element = self.token_index(name) as i32;
        self.spec(-element, 0, fields, ATTRIBUTE);
    }

    fn spec(&mut self, element: i32, jump: i32, fields: &[(&str, UsdValue)], kind: i32) {
        self.paths.push((element, jump));
        self.specs.push((self.field_sets.len() as i32, kind));
        for &(name, value) in fields {
            let field = (self.token_index(name), value);
            self.field_sets.push(self.fields.len() as i32);
            self.fields.push(field);
        }
        self.field_sets.push(-1);
    }

    /// Returns the bytes, and the position of the table of contents.
    pub fn finish(mut self) -> (Vec<u8>, u64) {
        // A jump of -2 marks the last property, which no sibling follows.
        if let Some((_, jump)) = self.paths.last_mut() {
            *jump = -2;
        }
        let text: Vec<u8> =
            self.tokens.iter().flat_map(|token| [token.as_bytes(), &[0]].concat()).collect();
        let packed_text = packed(&text);
        let count = |count: usize| (count as u64).to_le_bytes().to_vec();
        let tokens =
            [count(self.tokens.len()), count(text.len()), count(packed_text.len()), packed_text]
                .concat();
        let values: Vec<u8> =
            self.fields.iter().flat_map(|(_, value)| value.0.to_le_bytes()).collect();
        let values = packed(&values);
        let names = integers(self.fields.iter().map(|(name, _)| *name as i32));
        let fields = [count(self.fields.len()), names, count(values.len()), values].concat();
        let field_sets =
            [count(self.field_sets.len()), integers(self.field_sets.iter().copied())].concat();
        let numbers = integers(0..self.paths.len() as i32);
        let elements = integers(self.paths.iter().map(|(element, _)| *element));
        let jumps = integers(self.paths.iter().map(|(_, jump)| *jump));
        let paths = count(self.paths.len());
        let paths = [paths.clone(), paths, numbers.clone(), elements, jumps].concat();
        let sets = integers(self.specs.iter().map(|(set, _)| *set));
        let kinds = integers(self.specs.iter().map(|(_, kind)| *kind));
        let specs = [count(self.specs.len()), numbers, sets, kinds].concat();

        let mut bytes = self.values;
        let mut contents = Vec::new();
        let sections = [
            ("TOKENS", tokens),
            ("STRINGS", count(0)),
            ("FIELDS", fields),
            ("FIELDSETS", field_sets),
            ("PATHS", paths),
            ("SPECS", specs),
        ];
        contents.extend(count(sections.len()));
        for (name, section) in sections {
            let mut padded = [0; 16];
            padded[..name.len()].copy_from_slice(name.as_bytes());
            contents.extend(padded);
            contents.extend((self.at + bytes.len() as u64).to_le_bytes());
            contents.extend((section.len() as u64).to_le_bytes());
            bytes.extend(section);
        }
        let contents_at = self.at + bytes.len() as u64;
        bytes.extend(contents);
        (bytes, contents_at)
    }
}

/// The header of a file whose table of contents is at byte `contents_at`.
pub(super) fn header(contents_at: u64) -> Vec<u8> {
    let mut header = b"PXR-USDC\0\x08\0\0\0\0\0\0".to_vec();
    header.extend(contents_at.to_le_bytes());
    header.resize(HEADER as usize, 0);
    header
}

/// Encodes `bytes` as one chunk: a zero byte, followed by an LZ4 block of literals.
fn packed(bytes: &[u8]) -> Vec<u8> {
    const MOST: usize = 15;
    let mut out = vec![0, (bytes.len().min(MOST) as u8) << 4];
    if let Some(more) = bytes.len().checked_sub(MOST) {
        out.extend(std::iter::repeat_n(255, more / 255));
        out.push((more % 255) as u8);
    }
    out.extend_from_slice(bytes);
    out
}

/// Encodes the differences between consecutive numbers. A two-bit code says whether a difference is
/// 0 or is stored as an i32.
fn integers(numbers: impl ExactSizeIterator<Item = i32>) -> Vec<u8> {
    let mut codes = vec![0; numbers.len().div_ceil(4)];
    let mut differences = Vec::new();
    let mut before = 0;
    for (index, number) in numbers.enumerate() {
        let difference = number - std::mem::replace(&mut before, number);
        if difference != 0 {
            codes[index / 4] |= 3 << (2 * (index % 4));
            differences.extend(difference.to_le_bytes());
        }
    }
    let packed = packed(&[vec![0; 4], codes, differences].concat());
    [(packed.len() as u64).to_le_bytes().to_vec(), packed].concat()
}
