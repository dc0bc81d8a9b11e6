//! Builds geometry files of Houdini 12 and later: a tree of JSON in text or binary form, which may
//! be in a compressed container.

use std::collections::HashMap;

use super::zlib;

/// A JSON value.
#[derive(Debug, Clone)]
pub enum Value {
    Text(String),
    Integer(i64),
    Bool(bool),
    List(Vec<Value>),
    Map(Vec<Value>),
    /// Numbers with a storage type.
    Numbers(&'static str, Vec<f64>),
    Bits(Vec<bool>),
}

/// The encoding of a file's JSON.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Form {
    Text,
    Binary { big: bool, tokens: bool },
}

impl Form {
    pub const ALL: [Self; 4] = [
        Self::Text,
        Self::Binary { big: false, tokens: true },
        Self::Binary { big: true, tokens: true },
        Self::Binary { big: false, tokens: false },
    ];
}

/// The arrangement of the numbers of an attribute in a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Layout {
    Tuples,
    Arrays,
    /// Pages of this many points. In each page, the components form groups of these sizes. If all
    /// points of a page have the same values in a group, the group is stored as a constant.
    Pages(usize, Vec<usize>),
}

/// The storage types, each with the size of a number, in bytes, and the code of the number's type
/// in binary JSON.
pub const STORAGES: [(&str, usize, u8); 9] = [
    ("fpreal16", 2, 0x18),
    ("fpreal32", 4, 0x19),
    ("fpreal64", 8, 0x1a),
    ("int8", 1, 0x11),
    ("int16", 2, 0x12),
    ("int32", 4, 0x13),
    ("int64", 8, 0x14),
    ("uint8", 1, 0x21),
    ("uint16", 2, 0x22),
];

pub fn text(text: &str) -> Value {
    Value::Text(text.to_owned())
}

/// A list in which keys and values alternate.
pub fn keyed(entries: Vec<(&str, Value)>) -> Value {
    Value::List(entries.into_iter().flat_map(|(key, value)| [text(key), value]).collect())
}

/// The values of an attribute with `size` numbers for each point.
pub fn values(storage: &'static str, size: usize, numbers: &[f64], layout: &Layout) -> Value {
    let mut entries = vec![("size", Value::Integer(size as i64)), ("storage", text(storage))];
    let list = |numbers: Vec<f64>| Value::Numbers(storage, numbers);
    match layout {
        Layout::Tuples => {
            let tuples = numbers.chunks(size).map(|tuple| list(tuple.to_vec())).collect();
            entries.push(("tuples", Value::List(tuples)));
        }
        Layout::Arrays => {
            let array =
                |component| list(numbers.iter().copied().skip(component).step_by(size).collect());
            entries.push(("arrays", Value::List((0..size).map(array).collect())));
        }
        Layout::Pages(page, packing) => {
            let (mut raw, mut flags) = (Vec::new(), vec![Vec::new(); packing.len()]);
            for points in numbers.chunks(page * size) {
                let mut first = 0;
                for (group, &count) in packing.iter().enumerate() {
                    let tuples: Vec<&[f64]> =
                        points.chunks(size).map(|point| &point[first..first + count]).collect();
                    let is_constant = tuples.iter().all(|tuple| *tuple == tuples[0]);
                    flags[group].push(is_constant);
                    let stored = if is_constant { 1 } else { tuples.len() };
                    raw.extend(tuples[..stored].iter().flat_map(|tuple| tuple.iter().copied()));
                    first += count;
                }
            }
            entries.push(("pagesize", Value::Integer(*page as i64)));
            if packing.len() > 1 {
                let packing = packing.iter().map(|&count| count as f64).collect();
                entries.push(("packing", Value::Numbers("uint8", packing)));
            }
            if flags.iter().flatten().any(|&flag| flag) {
                // A group without a constant page may have no flags.
                let bits = flags.into_iter().map(|flags| match flags.contains(&true) {
                    true => Value::Bits(flags),
                    false => Value::List(Vec::new()),
                });
                entries.push(("constantpageflags", Value::List(bits.collect())));
            }
            entries.push(("rawpagedata", list(raw)));
        }
    }
    keyed(entries)
}

/// A point attribute: its definition and its data.
pub fn numeric(
    name: &str,
    storage: &'static str,
    size: usize,
    numbers: &[f64],
    layout: &Layout,
) -> Value {
    let data = keyed(vec![
        ("size", Value::Integer(size as i64)),
        ("storage", text(storage)),
        ("defaults", keyed(vec![("values", Value::Numbers("fpreal64", vec![0.0]))])),
        ("values", values(storage, size, numbers, layout)),
    ]);
    Value::List(vec![definition(name, "numeric"), data])
}

/// A string attribute of points. `numbers` are indices into `texts`, and -1 means no string.
pub fn strings(name: &str, texts: &[&str], numbers: &[f64], layout: &Layout) -> Value {
    let data = keyed(vec![
        ("size", Value::Integer(1)),
        ("storage", text("int32")),
        ("strings", Value::List(texts.iter().map(|own| text(own)).collect())),
        ("indices", values("int32", 1, numbers, layout)),
    ]);
    Value::List(vec![definition(name, "string"), data])
}

pub fn definition(name: &str, kind: &str) -> Value {
    let options = vec![text("type"), Value::Map(vec![text("value"), text("point")])];
    keyed(vec![
        ("scope", text("public")),
        ("type", text(kind)),
        ("name", text(name)),
        ("options", Value::Map(options)),
    ])
}

/// A geometry without primitives.
pub fn cloud(points: usize, attributes: Vec<Value>) -> Value {
    geometry(points, attributes, &[], Vec::new())
}

/// A geometry with primitives. `vertex_points` contains the point of every vertex, and each
/// primitive has a kind and data.
pub fn geometry(
    points: usize,
    attributes: Vec<Value>,
    vertex_points: &[f64],
    primitives: Vec<Value>,
) -> Value {
    let vertices = Value::Numbers("int32", vertex_points.to_vec());
    keyed(vec![
        ("fileversion", text("18.5.408")),
        ("hasindex", Value::Bool(false)),
        ("pointcount", Value::Integer(points as i64)),
        ("vertexcount", Value::Integer(vertex_points.len() as i64)),
        ("primitivecount", Value::Integer(primitives.len() as i64)),
        ("info", Value::Map(vec![text("artist"), text("\"no\\body\"\n\u{e9}")])),
        ("topology", keyed(vec![("pointref", keyed(vec![("indices", vertices)]))])),
        ("attributes", keyed(vec![("pointattributes", Value::List(attributes))])),
        ("primitives", Value::List(primitives)),
    ])
}

impl Value {
    /// The bytes of a document that consists of this value.
    pub fn document(&self, form: Form) -> Vec<u8> {
        let Form::Binary { big, tokens } = form else {
            let mut out = String::new();
            self.write_text(&mut out);
            return out.into_bytes();
        };
        let word = *b"NSJb";
        let mut binary = Binary { out: vec![0x7f], big, tokens, known: HashMap::new() };
        binary.number(u32::from_le_bytes(word).to_le_bytes());
        binary.write(self);
        binary.out
    }

    fn write_text(&self, out: &mut String) {
        let list = |out: &mut String, all: &[Self]| {
            for (number, value) in all.iter().enumerate() {
                out.push_str(if number > 0 { ",\n\t" } else { "" });
                value.write_text(out);
            }
        };
        match self {
            Self::Text(text) => out.push_str(&serde_json::to_string(text).expect("a text")),
            Self::Integer(whole) => out.push_str(&whole.to_string()),
            Self::Bool(truth) => out.push_str(&truth.to_string()),
            Self::List(all) => {
                out.push('[');
                list(out, all);
                out.push(']');
            }
            Self::Map(all) => {
                out.push('{');
                for (number, entry) in all.chunks(2).enumerate() {
                    out.push_str(if number > 0 { "," } else { "" });
                    entry[0].write_text(out);
                    out.push(':');
                    entry[1].write_text(out);
                }
                out.push('}');
            }
            Self::Numbers(_, numbers) => {
                let numbers: Vec<_> = numbers.iter().map(f64::to_string).collect();
                out.push_str(&format!("[{}\n]", numbers.join(",")));
            }
            Self::Bits(bits) => {
                let bits: Vec<_> = bits.iter().map(bool::to_string).collect();
                out.push_str(&format!("[{}]", bits.join(",")));
            }
        }
    }
}

struct Binary {
    out: Vec<u8>,
    big: bool,
    tokens: bool,
    known: HashMap<String, usize>,
}

impl Binary {
    fn number<const N: usize>(&mut self, mut bytes: [u8; N]) {
        if self.big {
            bytes.reverse();
        }
        self.out.extend(bytes);
    }

    fn length(&mut self, length: usize) {
        match length {
            ..=0xf0 => self.out.push(length as u8),
            0xf1..=0xffff => {
                self.out.push(0xf2);
                self.number((length as u16).to_le_bytes());
            }
            _ => {
                self.out.push(0xf4);
                self.number((length as u32).to_le_bytes());
            }
        }
    }

    fn text(&mut self, text: &str) {
        self.length(text.len());
        self.out.extend(text.as_bytes());
    }

    fn write(&mut self, value: &Value) {
        match value {
            Value::Text(text) if self.tokens => {
                let next = self.known.len();
                let known = self.known.get(text).copied();
                let number = known.unwrap_or(next);
                if known.is_none() {
                    self.known.insert(text.clone(), next);
                    self.out.push(0x2b);
                    self.length(number);
                    self.text(text);
                }
                self.out.push(0x26);
                self.length(number);
            }
            Value::Text(text) => {
                self.out.push(0x27);
                self.text(text);
            }
            Value::Integer(whole) => {
                self.out.push(0x14);
                self.number(whole.to_le_bytes());
            }
            Value::Bool(truth) => self.out.push(if *truth { 0x31 } else { 0x30 }),
            Value::List(all) => {
                self.out.push(0x5b);
                all.iter().for_each(|value| self.write(value));
                self.out.push(0x5d);
            }
            Value::Map(all) => {
                self.out.push(0x7b);
                all.iter().for_each(|value| self.write(value));
                self.out.push(0x7d);
            }
            Value::Numbers(storage, numbers) => {
                let (_, _, kind) = STORAGES.iter().find(|(name, ..)| name == storage).unwrap();
                self.out.extend([0x40, *kind]);
                self.length(numbers.len());
                for &number in numbers {
                    match *storage {
                        "fpreal16" => self.number(half(number).to_le_bytes()),
                        "fpreal32" => self.number((number as f32).to_le_bytes()),
                        "fpreal64" => self.number(number.to_le_bytes()),
                        "int8" => self.number((number as i8).to_le_bytes()),
                        "int16" => self.number((number as i16).to_le_bytes()),
                        "int32" => self.number((number as i32).to_le_bytes()),
                        "int64" => self.number((number as i64).to_le_bytes()),
                        "uint8" => self.number((number as u8).to_le_bytes()),
                        "uint16" => self.number((number as u16).to_le_bytes()),
                        other => panic!("{other}"),
                    }
                }
            }
            Value::Bits(bits) => {
                self.out.extend([0x40, 0x10]);
                self.length(bits.len());
                for bits in bits.chunks(32) {
                    let word =
                        bits.iter().zip(0..).map(|(&bit, at)| u32::from(bit) << at).sum::<u32>();
                    self.number(word.to_le_bytes());
                }
            }
        }
    }
}

/// Converts a number to half precision, which must represent it exactly as a normal number.
fn half(number: f64) -> u16 {
    if number == 0.0 {
        return 0;
    }
    let bits = number.to_bits();
    let exponent = (bits >> 52 & 0x7ff) as i64 - 1023 + 15;
    assert!((1..31).contains(&exponent), "{number}");
    (bits >> 63 << 15) as u16 | (exponent << 10) as u16 | (bits >> 42 & 0x3ff) as u16
}

/// The compression of chunks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Codec {
    Stored,
    Lz4,
    Zlib,
    Zstd,
}

/// The order of the bytes in a chunk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shuffle {
    None,
    Bytes,
    Bits,
}

/// A container of chunks.
#[derive(Debug, Clone, Copy)]
pub struct Container {
    pub codec: Codec,
    pub shuffle: Shuffle,
    pub type_size: usize,
    /// The uncompressed size of a chunk, in bytes.
    pub chunk: usize,
    /// The uncompressed size of a block, in bytes.
    pub block: usize,
    /// Whether each block is compressed as several streams: one for the first bytes of all numbers,
    /// one for the second bytes, and so on.
    pub split: bool,
}

impl Container {
    /// The parameters that Houdini uses.
    pub const USUAL: Self = Self {
        codec: Codec::Lz4,
        shuffle: Shuffle::Bytes,
        type_size: 4,
        chunk: 1 << 20,
        block: 1 << 16,
        split: true,
    };

    pub fn pack(self, bytes: &[u8]) -> Vec<u8> {
        let mut out = b"scf1".to_vec();
        out.extend(0_u64.to_be_bytes());
        let start = out.len();
        let (mut index, mut last) = (Vec::new(), 0);
        // Without data, the container still has one empty chunk.
        let chunks: Vec<&[u8]> = match bytes {
            [] => vec![&[]],
            _ => bytes.chunks(self.chunk).collect(),
        };
        for (number, chunk) in chunks.into_iter().enumerate() {
            if number > 0 {
                index.extend(((out.len() - start) as u64).to_be_bytes());
            }
            out.extend(self.pack_chunk(chunk));
            last = chunk.len();
        }
        index.extend((self.chunk as u64).to_be_bytes());
        index.extend((last as u64).to_be_bytes());
        out.extend(&index);
        out.extend((index.len() as u64).to_be_bytes());
        out.extend(b"1fcs");
        out
    }

    fn pack_chunk(self, bytes: &[u8]) -> Vec<u8> {
        let codec = match self.codec {
            Codec::Stored => 0b10,
            Codec::Lz4 => 1 << 5,
            Codec::Zlib => 3 << 5,
            Codec::Zstd => 4 << 5,
        };
        let shuffle = match self.shuffle {
            Shuffle::None => 0,
            Shuffle::Bytes => 1,
            Shuffle::Bits => 4,
        };
        let split = if self.split { 0 } else { 0x10 };
        let mut body = Vec::new();
        if self.codec == Codec::Stored {
            body.extend(bytes);
        } else {
            let blocks: Vec<&[u8]> = bytes.chunks(self.block).collect();
            let mut packed = Vec::new();
            for block in &blocks {
                body.extend(((16 + 4 * blocks.len() + packed.len()) as u32).to_le_bytes());
                let shuffled = self.shuffled(block);
                let is_split = self.split
                    && block.len() == self.block
                    && block.len() / self.type_size >= 128
                    && self.type_size <= 16;
                let streams = if is_split { self.type_size } else { 1 };
                for stream in shuffled.chunks(block.len() / streams) {
                    let small = match self.codec {
                        Codec::Stored => Vec::new(),
                        Codec::Lz4 => lz4_flex::block::compress(stream),
                        Codec::Zlib => zlib(stream),
                        Codec::Zstd => zstd::bulk::compress(stream, 3).expect("memory"),
                    };
                    let small = if small.len() < stream.len() { &small } else { stream };
                    packed.extend((small.len() as u32).to_le_bytes());
                    packed.extend(small);
                }
            }
            body.extend(packed);
        }
        let mut chunk = vec![2, 1, codec | shuffle | split, self.type_size as u8];
        let lengths = [bytes.len(), self.block, 16 + body.len()];
        chunk.extend(lengths.iter().flat_map(|&length| (length as u32).to_le_bytes()));
        chunk.extend(body);
        chunk
    }

    fn shuffled(self, block: &[u8]) -> Vec<u8> {
        let count = block.len() / self.type_size;
        let (whole, rest) = block.split_at(count * self.type_size);
        let numbers = || whole.chunks(self.type_size);
        match self.shuffle {
            Shuffle::Bytes if self.type_size > 1 => {
                let bytes = (0..self.type_size).flat_map(|byte| numbers().map(move |n| n[byte]));
                bytes.chain(rest.iter().copied()).collect()
            }
            Shuffle::Bits if count.is_multiple_of(8) => {
                let bits = (0..8 * self.type_size)
                    .flat_map(|bit| numbers().map(move |n| n[bit / 8] >> (bit % 8) & 1));
                let bits: Vec<u8> = bits.collect();
                let bytes = bits
                    .chunks(8)
                    .map(|bits| bits.iter().zip(0..).map(|(&bit, at)| bit << at).sum::<u8>());
                bytes.chain(rest.iter().copied()).collect()
            }
            _ => block.to_vec(),
        }
    }
}

/// A primitive of a kind, with its data.
pub fn primitive(kind: &str, data: Vec<(&str, Value)>) -> Value {
    Value::List(vec![keyed(vec![("type", text(kind))]), keyed(data)])
}

/// The corners of the sides of a cube with the points 0 to 7, where point n has the coordinates n &
/// 1, n >> 1 & 1 and n >> 2. As in Houdini, corners are clockwise as seen from outside.
pub const SIDES: [[u32; 4]; 6] =
    [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]];

/// The sides of a cube, as single polygons, as a run that lists the corners of each polygon, and as
/// runs of consecutive corners. An open polygon and a curve go along one side.
pub fn cubes() -> Vec<Value> {
    let corners = |first: usize, count: usize| {
        Value::Numbers("int32", (first..first + count).map(|corner| corner as f64).collect())
    };
    let closed = |closed: bool| Value::Map(vec![text("closed"), Value::Bool(closed)]);
    let run = |varying: &[&str], uniform: Value, polygons: Vec<Value>| {
        let varying = Value::List(varying.iter().map(|name| text(name)).collect());
        let kind = keyed(vec![
            ("type", text("run")),
            ("runtype", text("Poly")),
            ("varyingfields", varying),
            ("uniformfields", uniform),
        ]);
        Value::List(vec![kind, Value::List(polygons)])
    };
    let of_run = |kind: &str, sizes: (&str, Vec<f64>), count: i64| {
        let start = if kind == "p_r" { ["s_v", "n_p"] } else { ["startvertex", "nprimitives"] };
        let sizes = (sizes.0, Value::Numbers("uint8", sizes.1));
        let data = vec![(start[0], Value::Integer(0)), (start[1], Value::Integer(count)), sizes];
        primitive(kind, data)
    };
    let curve = of_run("PolygonCurve_run", ("nvertices", vec![4.0]), 1);
    let open = primitive("Poly", vec![("vertex", corners(24, 4)), ("closed", Value::Bool(false))]);
    let single = |side: usize| {
        primitive("Poly", vec![("closed", Value::Bool(true)), ("vertex", corners(4 * side, 4))])
    };
    let lone = |side: usize| Value::List(vec![corners(4 * side, 4)]);
    let marked = |(side, is_closed): (usize, bool)| {
        Value::List(vec![Value::Bool(is_closed), corners(4 * side, 4)])
    };
    let sides = 0..6;
    let some_open = sides.clone().map(|side| (side, true)).chain([(6, false)]);
    let geometries = vec![
        sides.clone().map(single).chain([open, curve.clone()]).collect(),
        vec![
            run(&["vertex"], closed(true), sides.map(lone).collect()),
            run(&["vertex"], closed(false), vec![lone(6)]),
        ],
        vec![run(&["closed", "vertex"], Value::Map(Vec::new()), some_open.map(marked).collect())],
        vec![of_run("Polygon_run", ("nvertices_rle", vec![4.0, 2.0, 4.0, 4.0]), 6), curve],
        vec![of_run("p_r", ("n_v", vec![4.0; 6]), 6)],
    ];
    // The corners of the open polygon and of the curve come last.
    let corners = SIDES.as_flattened().iter().chain(&SIDES[0]);
    let vertices: Vec<f64> = corners.map(|&point| f64::from(point)).collect();
    let points: Vec<f64> =
        (0..8).flat_map(|n| [n & 1, n >> 1 & 1, n >> 2]).map(f64::from).collect();
    let geometries = geometries.into_iter().map(|primitives: Vec<Value>| {
        let position = numeric("P", "fpreal32", 3, &points, &Layout::Pages(1024, vec![3]));
        geometry(8, vec![position], &vertices, primitives)
    });
    geometries.collect()
}
