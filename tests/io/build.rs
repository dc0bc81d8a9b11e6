//! Builds files in every binary layout, byte by byte as the formats' specifications say.

#[path = "build/houdini.rs"]
pub mod houdini;

use std::io::{Cursor, Write};

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use flate2::Compression;
use flate2::write::{GzEncoder, ZlibEncoder};
use lzma_rust2::{XzOptions, XzWriter};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// Positions with coordinates that all differ, and that f32 represents exactly.
pub fn tuples(count: usize) -> Vec<[f64; 3]> {
    (0..count).map(|i| [0, 1, 2].map(|axis| (3 * i + axis) as f64 * 0.375 - 2.0)).collect()
}

pub fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    encoder.write_all(bytes).expect("memory accepts all bytes");
    encoder.finish().expect("memory accepts all bytes")
}

pub fn zlib(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::best());
    encoder.write_all(bytes).expect("memory accepts all bytes");
    encoder.finish().expect("memory accepts all bytes")
}

pub fn xz(bytes: &[u8]) -> Vec<u8> {
    let options = XzOptions::with_preset(0);
    let mut encoder = XzWriter::new(Vec::new(), options).expect("memory accepts all bytes");
    encoder.write_all(bytes).expect("memory accepts all bytes");
    encoder.finish().expect("memory accepts all bytes")
}

pub fn raw(points: &[[f64; 3]]) -> Vec<u8> {
    points.as_flattened().iter().flat_map(|&x| (x as f32).to_le_bytes()).collect()
}

pub fn npy_header(descr: &str, fortran: bool, shape: &str) -> Vec<u8> {
    let order = if fortran { "True" } else { "False" };
    let mut header =
        format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}");
    while !(10 + header.len() + 1).is_multiple_of(64) {
        header.push(' ');
    }
    header.push('\n');
    [b"\x93NUMPY\x01\x00", (header.len() as u16).to_le_bytes().as_slice(), header.as_bytes()]
        .concat()
}

pub fn npy(points: &[[f64; 3]], descr: &str, fortran: bool) -> Vec<u8> {
    let mut bytes = npy_header(descr, fortran, &format!("({}, 3)", points.len()));
    let by_axis = || (0..3).flat_map(|axis| points.iter().map(move |p| p[axis]));
    let values: Vec<f64> =
        if fortran { by_axis().collect() } else { points.as_flattened().to_vec() };
    for x in values {
        match descr {
            "<f4" => bytes.extend((x as f32).to_le_bytes()),
            ">f4" => bytes.extend((x as f32).to_be_bytes()),
            "<f8" => bytes.extend(x.to_le_bytes()),
            _ => bytes.extend(x.to_be_bytes()),
        }
    }
    bytes
}

/// An .npz file: a zip archive of arrays with these names.
pub fn npz(arrays: &[(&str, Vec<u8>)], compression: CompressionMethod) -> Vec<u8> {
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, array) in arrays {
        let options = SimpleFileOptions::default().compression_method(compression);
        archive.start_file(format!("{name}.npy"), options).expect("memory accepts all bytes");
        archive.write_all(array).expect("memory accepts all bytes");
    }
    archive.finish().expect("memory accepts all bytes").into_inner()
}

/// An .npz file with positions, velocities twice as large, ids, and an array that does not belong
/// to the particles.
pub fn npz_frame(points: &[[f64; 3]], compression: CompressionMethod) -> Vec<u8> {
    let doubled: Vec<_> = points.iter().map(|p| p.map(|x| 2.0 * x)).collect();
    let mut ids = npy_header("<i4", false, &format!("({},)", points.len()));
    ids.extend((0..points.len() as i32).flat_map(i32::to_le_bytes));
    let arrays = [
        ("vel", npy(&doubled, "<f4", true)),
        ("pos", npy(points, "<f8", false)),
        ("id", ids),
        ("dt", npy_header("<f8", false, "()").into_iter().chain([0; 8]).collect()),
        ("names", npy_header("<U1", false, "(2,)").into_iter().chain([0; 8]).collect()),
    ];
    npz(&arrays, compression)
}

/// The place and encoding of the numbers of a .vtu or .vtp file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Placed {
    Ascii,
    Base64,
    AppendedRaw,
    AppendedBase64,
}

/// The compression of the blocks of a .vtu or .vtp file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Compressor {
    None,
    Zlib,
    Lz4,
    Lzma,
}

/// The layout of a .vtu or .vtp file.
#[derive(Clone, Copy, Debug)]
pub struct VtkXml {
    pub placed: Placed,
    pub compressor: Compressor,
    pub big: bool,
    pub wide: bool,
}

impl VtkXml {
    pub fn all() -> Vec<Self> {
        let mut all = Vec::new();
        for placed in [Placed::Ascii, Placed::Base64, Placed::AppendedRaw, Placed::AppendedBase64] {
            for [big, wide] in [[false; 2], [false, true], [true, false], [true; 2]] {
                let layout = |compressor| Self { placed, compressor, big, wide };
                all.extend([Compressor::None, Compressor::Zlib].map(layout));
                if placed != Placed::Ascii && big != wide {
                    all.extend([Compressor::Lz4, Compressor::Lzma].map(layout));
                }
            }
        }
        all
    }

    pub fn is_compressed(self) -> bool {
        self.compressor != Compressor::None
    }

    /// Builds a file at time 1.5, with ids and with velocities twice as large as the positions.
    pub fn build(self, points: &[[f64; 3]]) -> Vec<u8> {
        self.build_cells(points, &[])
    }

    /// Builds a file like that of [`build`](Self::build), with a cell type for each point.
    pub fn build_cells(self, points: &[[f64; 3]], types: &[f64]) -> Vec<u8> {
        let mut appended = Vec::new();
        let mut array = |what: &str, kind: &str, numbers: &[f64]| {
            let mut element = format!("<DataArray type=\"{kind}\" {what} ");
            let stored: Vec<u8> = numbers.iter().flat_map(|&x| self.number(kind, x)).collect();
            element += &match self.placed {
                Placed::Ascii => {
                    let text: Vec<_> = numbers.iter().map(f64::to_string).collect();
                    format!("format=\"ascii\">\n{}\n</DataArray>", text.join(" "))
                }
                Placed::Base64 => {
                    format!("format=\"binary\">\n  {}\n</DataArray>", self.base64(&stored))
                }
                placed => {
                    let offset = appended.len();
                    match placed {
                        Placed::AppendedRaw => appended.extend(self.packed(&stored).concat()),
                        _ => appended.extend(self.base64(&stored).into_bytes()),
                    }
                    format!("format=\"appended\" offset=\"{offset}\"/>")
                }
            };
            element
        };
        let flat = points.as_flattened();
        let doubled: Vec<_> = flat.iter().map(|x| 2.0 * x).collect();
        let ids: Vec<_> = (0..points.len()).map(|id| id as f64).collect();
        let connectivity = array("Name=\"connectivity\"", "Int64", &ids);
        let time = array("Name=\"TimeValue\" NumberOfTuples=\"1\"", "Float64", &[1.5]);
        let velocity = array("Name=\"velocity\" NumberOfComponents=\"3\"", "Float32", &doubled);
        let id = array("Name=\"id\"", "Int32", &ids);
        let position = array("Name=\"Points\" NumberOfComponents=\"3\"", "Float32", flat);
        let types = match types {
            [] => String::new(),
            _ => array("Name=\"types\"", "Int32", types),
        };
        let compressor = match self.compressor {
            Compressor::None => "",
            Compressor::Zlib => " compressor=\"vtkZLibDataCompressor\"",
            Compressor::Lz4 => " compressor=\"vtkLZ4DataCompressor\"",
            Compressor::Lzma => " compressor=\"vtkLZMADataCompressor\"",
        };
        let mut bytes = format!(
            "<?xml version=\"1.0\"?>\n\
             <VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\"{}Endian\" \
             header_type=\"UInt{}\"{compressor}>\n\
             <UnstructuredGrid><FieldData>{time}</FieldData>\n\
             <Piece NumberOfPoints=\"{count}\" NumberOfCells=\"{count}\">\n\
             <PointData Vectors=\"velocity\">{velocity}\n{id}</PointData>\n\
             <Points>{position}</Points>\n\
             <Cells>{connectivity}{types}</Cells>\n\
             </Piece></UnstructuredGrid>",
            if self.big { "Big" } else { "Little" },
            if self.wide { 64 } else { 32 },
            count = points.len(),
        )
        .into_bytes();
        match self.placed {
            Placed::AppendedRaw => bytes.extend(b"<AppendedData encoding=\"raw\">\n _"),
            Placed::AppendedBase64 => bytes.extend(b"<AppendedData encoding=\"base64\">_"),
            Placed::Ascii | Placed::Base64 => {}
        }
        if !appended.is_empty() {
            bytes.extend(appended);
            bytes.extend(b"\n</AppendedData>");
        }
        bytes.extend(b"</VTKFile>\n");
        bytes
    }

    fn number(self, kind: &str, x: f64) -> Vec<u8> {
        let mut bytes = match kind {
            "Float32" => (x as f32).to_le_bytes().to_vec(),
            "Float64" => x.to_le_bytes().to_vec(),
            "Int32" => (x as i32).to_le_bytes().to_vec(),
            _ => (x as i64).to_le_bytes().to_vec(),
        };
        if self.big {
            bytes.reverse();
        }
        bytes
    }

    /// Encodes the data of an array, and returns the header and the encoded data.
    fn packed(self, data: &[u8]) -> [Vec<u8>; 2] {
        const BLOCK: usize = 32;
        if !self.is_compressed() {
            return [self.length(data.len()), data.to_vec()];
        }
        let blocks: Vec<Vec<u8>> = data
            .chunks(BLOCK)
            .map(|block| match self.compressor {
                Compressor::Lz4 => lz4_flex::block::compress(block),
                Compressor::Lzma => xz(block),
                _ => zlib(block),
            })
            .collect();
        let lengths = [blocks.len(), BLOCK, data.len() % BLOCK];
        let lengths = lengths.into_iter().chain(blocks.iter().map(Vec::len));
        [lengths.flat_map(|length| self.length(length)).collect(), blocks.concat()]
    }

    /// Encodes an array as base64. The header of a compressed array is encoded separately.
    fn base64(self, data: &[u8]) -> String {
        let [header, data] = self.packed(data);
        match self.is_compressed() {
            true => BASE64_STANDARD.encode(header) + &BASE64_STANDARD.encode(data),
            false => BASE64_STANDARD.encode([header, data].concat()),
        }
    }

    fn length(self, length: usize) -> Vec<u8> {
        let mut bytes = (length as u64).to_le_bytes()[..if self.wide { 8 } else { 4 }].to_vec();
        if self.big {
            bytes.reverse();
        }
        bytes
    }
}

/// A .bgeo file with the attributes id, v, an indexed string, uv, and a second v. The points are at
/// the end of the file, so that a reader needs every byte.
pub fn bgeo(points: &[[f64; 3]]) -> Vec<u8> {
    let mut bytes = b"BgeoV".to_vec();
    let int = |bytes: &mut Vec<u8>, x: i32| bytes.extend(x.to_be_bytes());
    let name = |bytes: &mut Vec<u8>, name: &str| {
        bytes.extend((name.len() as u16).to_be_bytes());
        bytes.extend(name.as_bytes());
    };
    for x in [5, points.len() as i32, 0, 0, 0, 5, 0, 0, 0] {
        int(&mut bytes, x);
    }
    for (called, components, kind) in
        [("id", 1u16, 1), ("v", 3, 5), ("group", 1, 4), ("uv", 2, 0), ("v", 3, 0)]
    {
        name(&mut bytes, called);
        bytes.extend(components.to_be_bytes());
        int(&mut bytes, kind);
        if kind == 4 {
            int(&mut bytes, 2);
            name(&mut bytes, "water");
            name(&mut bytes, "");
        } else {
            bytes.extend(vec![0; 4 * usize::from(components)]);
        }
    }
    for (i, p) in points.iter().enumerate() {
        let floats = |bytes: &mut Vec<u8>, values: &[f32]| {
            values.iter().for_each(|x| bytes.extend(x.to_be_bytes()));
        };
        let shift = i as f32;
        floats(&mut bytes, &[p[0] as f32, p[1] as f32, p[2] as f32, 1.0]);
        int(&mut bytes, i as i32 - 1);
        floats(&mut bytes, &[0.5 + shift, 1.5 + shift, 2.5 + shift]);
        int(&mut bytes, [1, -1, 0, 1][i % 4]);
        floats(&mut bytes, &[0.25 + shift, 0.75 + shift, -1.0, -1.0, -1.0]);
    }
    bytes
}

/// The layout of a .bi4 file.
#[derive(Clone, Copy)]
pub struct Bi4 {
    /// Whether numbers are big-endian.
    pub big: bool,
    /// Whether the sizes of arrays have 64 bits.
    pub wide: bool,
    /// Whether positions and identifiers have 64 bits.
    pub double: bool,
    /// Whether boundary and fluid particles alternate. Otherwise, the boundary particles come
    /// first.
    pub mixed: bool,
    pub pieces: u32,
    /// The number of this piece.
    pub piece: u32,
}

impl Bi4 {
    /// Builds a part with fluid particles at `points`, numbered from 5 on, and 5 other particles.
    /// The spacing is 0.25, and each velocity is twice the position.
    pub fn build(self, points: &[[f64; 3]]) -> Vec<u8> {
        self.build_spaced(points, 0.25)
    }

    /// Builds the same part with the given spacing.
    pub fn build_spaced(self, points: &[[f64; 3]], spacing: f64) -> Vec<u8> {
        let mut head = b"#FileJBD JPartDataBi4".to_vec();
        head.resize(58, b' ');
        head.extend([
            b'\n',
            0,
            u8::from(self.big) + 10 * u8::from(self.wide),
            u8::from(self.wide),
            0,
            0,
        ]);

        let mut values = Vec::new();
        for (name, count) in
            [("CaseNfixed", 2), ("CaseNmoving", 1), ("CaseNfloat", 2), ("CaseNfluid", 7)]
        {
            values.push((name, 10, self.u64(count)));
        }
        values.push(("CaseName", 1, self.text("Dam")));
        values.push(("NpDynamic", 2, self.u32(0)));
        values.push(("Piece", 8, self.u32(self.piece)));
        values.push(("Npiece", 8, self.u32(self.pieces)));
        values.push(("Dp", 12, self.u64(spacing.to_bits())));
        head.extend(self.item("JPartDataBi4", 0, 1, &self.values(&values)));

        let mut rows: Vec<(u64, [f64; 3])> = (0..5).map(|id| (id, [-9.0; 3])).collect();
        rows.extend((5..).zip(points.iter().copied()));
        if self.mixed {
            rows.sort_by_key(|(id, _)| (if *id < 5 { 2 * id } else { 2 * (id - 5) + 1 }, *id));
        }
        let ids = rows
            .iter()
            .flat_map(|&(id, _)| if self.double { self.u64(id) } else { self.u32(id as u32) });
        let position =
            rows.iter().flat_map(|(_, p)| p.map(|x| self.float(x, self.double)).concat());
        let velocity =
            rows.iter().flat_map(|(_, p)| p.map(|x| self.float(2.0 * x, false)).concat());
        let (id_kind, position_kind) = if self.double { (10, 23) } else { (8, 22) };
        let (id_name, position_name) = if self.double { ("Idpd", "Posd") } else { ("Idp", "Pos") };
        let time = self.values(&[("TimeStep", 12, self.u64(1.5f64.to_bits()))]);
        head.extend(self.item("PART_0000", 3, 0, &time));
        head.extend(self.array(id_name, id_kind, rows.len(), &ids.collect::<Vec<_>>()));
        head.extend(self.array(
            position_name,
            position_kind,
            rows.len(),
            &position.collect::<Vec<_>>(),
        ));
        head.extend(self.array("Vel", 22, rows.len(), &velocity.collect::<Vec<_>>()));
        head
    }

    fn item(self, name: &str, arrays: u32, items: u32, values: &[u8]) -> Vec<u8> {
        let definition = [
            self.text("\nITEM\n"),
            self.text(name),
            vec![0; 8],
            self.text("%.7E"),
            self.text("%.15E"),
            self.u32(arrays),
            self.u32(items),
            self.u32(values.len() as u32),
        ]
        .concat();
        [self.u32(definition.len() as u32), definition, values.to_vec()].concat()
    }

    fn values(self, values: &[(&str, u32, Vec<u8>)]) -> Vec<u8> {
        let mut bytes = [self.text("\nVALUES"), self.u32(values.len() as u32)].concat();
        for (name, kind, payload) in values {
            bytes.extend([self.text(name), self.u32(*kind), payload.clone()].concat());
        }
        bytes
    }

    fn array(self, name: &str, kind: u32, count: usize, data: &[u8]) -> Vec<u8> {
        let size = |x: usize| if self.wide { self.u64(x as u64) } else { self.u32(x as u32) };
        let definition = [
            self.text("\nARRAY"),
            self.text(name),
            vec![0; 4],
            self.u32(kind),
            size(count),
            size(data.len()),
        ]
        .concat();
        [self.u32(definition.len() as u32), definition, data.to_vec()].concat()
    }

    fn text(self, text: &str) -> Vec<u8> {
        [self.u32(text.len() as u32), text.as_bytes().to_vec()].concat()
    }

    fn u32(self, x: u32) -> Vec<u8> {
        if self.big { x.to_be_bytes() } else { x.to_le_bytes() }.to_vec()
    }

    fn u64(self, x: u64) -> Vec<u8> {
        if self.big { x.to_be_bytes() } else { x.to_le_bytes() }.to_vec()
    }

    fn float(self, x: f64, double: bool) -> Vec<u8> {
        if double { self.u64(x.to_bits()) } else { self.u32((x as f32).to_bits()) }
    }
}
