//! Fuzzes compressed and checksummed files, which are built from mutated bytes.

use std::path::Path;

use meniscus::files;
use meniscus::internals::io::input::{open_particles, steps};
use meniscus::internals::io::{npz, vtp};
use zip::CompressionMethod;

use super::build::{self, gzip, xz};
use super::particles::{self, NPY, memory, own, read_through};
use super::{Target, folder, meshes};

/// A function that compresses bytes.
type Pack = dyn Fn(&[u8]) -> Vec<u8>;
type PackBlock = fn(&[u8]) -> Vec<u8>;

pub fn targets() -> Vec<Target> {
    vec![
        Target { name: "gzip", runs: 2000, run: run_gzip, seeds: gzips, words: &["\u{1f}"] },
        Target { name: "xz-and-zstd", runs: 1000, run: run_streams, seeds: streams, words: &[] },
        Target { name: "npz-arrays", runs: 2000, run: run_npz, seeds: arrays, words: NPY },
        Target { name: "vtu-blocks", runs: 3000, run: run_blocks, seeds: blocks, words: &[] },
        Target {
            name: "info",
            runs: 3000,
            run: run_info,
            seeds: infos,
            words: &["POINTS ", "element face 1\n", "<Piece Source=\"a.vtu\"/>"],
        },
    ]
}

/// Reads gzip files. The first byte selects the format of the content, and whether the content or
/// the compressed stream is damaged.
fn run_gzip(data: &[u8]) {
    let Some((choice, data)) = data.split_first() else { return };
    let name =
        ["a.bgeo", "a.xyz", "a.npy.gz", "a.ply", "a.csv.gz", "a.bi4"][usize::from(choice & 7) % 6];
    let packed = match choice >> 3 & 3 {
        0 => [gzip(data), gzip(data)].concat(),
        // A compressed stream without its last bytes.
        1 => {
            let mut packed = gzip(data);
            let end = packed.len() - usize::from(choice >> 5);
            packed.truncate(end);
            packed
        }
        2 => [b"\x1f\x8b", data].concat(),
        _ => gzip(data),
    };
    read_through(
        open_particles(&folder::file(name, &packed), memory()).map_err(|error| error.fault),
    );
}

fn gzips() -> Vec<Vec<u8>> {
    let files = [
        build::bgeo(&build::tuples(3)),
        build::raw(&build::tuples(3)),
        build::npy(&build::tuples(3), "<f4", false),
    ];
    let wrapped = (0_u8..).zip(files).map(|(kind, file)| [&[kind | 0x18][..], &file].concat());
    let packed = [&[0x11][..], &gzip(&build::raw(&build::tuples(3)))[2..]].concat();
    wrapped.chain([packed]).collect()
}

/// Reads xz and zstd files. The first byte selects the compression, and whether the mutated bytes
/// are the content or the compressed bytes.
fn run_streams(data: &[u8]) {
    let Some((choice, data)) = data.split_first() else { return };
    let zstd = |data: &[u8]| zstd::encode_all(data, 1).unwrap();
    let (name, magic, pack): (_, &[u8], &Pack) = match choice & 1 {
        0 => ("a.npy.xz", b"\xfd7zXZ\0", &xz),
        _ => ("a.csv.zst", b"\x28\xb5\x2f\xfd", &zstd),
    };
    let packed = match choice >> 1 & 3 {
        0 => pack(data),
        1 => [pack(data), pack(data)].concat(),
        // A compressed stream without its last bytes.
        2 => {
            let mut packed = pack(data);
            packed.truncate(packed.len().saturating_sub(usize::from(choice >> 3)));
            packed
        }
        _ => [magic, data].concat(),
    };
    let read = open_particles(&folder::file(name, &packed), memory());
    read_through(read.map_err(|error| error.fault));
}

fn streams() -> Vec<Vec<u8>> {
    let array = build::npy(&build::tuples(3), "<f4", false);
    let table = b"x,y,z,phase\n1,2,3,water\n4,5,6,air\n".to_vec();
    let zstd = zstd::encode_all(&*table, 1).unwrap();
    vec![
        [&[0][..], &array].concat(),
        [&[1][..], &table].concat(),
        [&[6][..], &xz(&array)[6..]].concat(),
        [&[7][..], &zstd[4..]].concat(),
    ]
}

/// Reads an .npz archive with correct checksums. In `data`, the first byte selects the compression.
/// The length of each array precedes the array, and takes two bytes.
fn run_npz(data: &[u8]) {
    let Some((choice, mut data)) = data.split_first() else { return };
    let mut arrays = Vec::new();
    for name in ["pos", "vel", "x", "y", "z", "id"] {
        let Some((length, rest)) = data.split_first_chunk::<2>() else { break };
        let (array, rest) = rest.split_at(usize::from(u16::from_le_bytes(*length)).min(rest.len()));
        arrays.push((name, array.to_vec()));
        data = rest;
    }
    let compression =
        if choice & 1 == 0 { CompressionMethod::Stored } else { CompressionMethod::Deflated };
    read_through(npz::read_particles(own(&build::npz(&arrays, compression)), None, memory()));
}

fn arrays() -> Vec<Vec<u8>> {
    let with_length = |array: &Vec<u8>| [&(array.len() as u16).to_le_bytes()[..], array].concat();
    let arrays = particles::npys();
    let pair = |pair: &[Vec<u8>]| [vec![1], pair.iter().flat_map(with_length).collect()].concat();
    arrays.chunks(2).map(pair).collect()
}

/// Reads a VTK file whose blocks are compressed with zlib, LZ4 or LZMA. The first eight bytes
/// select the value type, the compression, the number of points and the lengths of blocks.
fn run_blocks(data: &[u8]) {
    let Some((head, data)) = data.split_first_chunk::<8>() else { return };
    let [kind, points, block, last, count, ..] = *head;
    let (kinds, sizes) =
        (["Float32", "Float64", "Int8", "UInt16", "Int64", "Float32"], [4, 8, 1, 2, 8, 4]);
    let (compressor, pack): (_, PackBlock) = match usize::from(kind) / kinds.len() % 3 {
        0 => ("ZLib", zlib),
        1 => ("LZ4", lz4_flex::block::compress),
        _ => ("LZMA", xz),
    };
    let kind = usize::from(kind) % kinds.len();
    let (block, points) = (usize::from(block).max(1), usize::from(points));
    let whole: Vec<Vec<u8>> = data.chunks(block).map(pack).collect();
    let mut lengths = vec![whole.len() as u32, block as u32, (data.len() % block) as u32];
    lengths.extend(whole.iter().map(|block| block.len() as u32));
    // All lengths are correct, but a nonzero `count` selects one length to change.
    if count != 0 {
        let at = usize::from(count) % lengths.len();
        lengths[at] = lengths[at].wrapping_add(u32::from(last)).wrapping_sub(128);
    }
    let mut file = format!(
        "<VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt32\" \
         compressor=\"vtk{compressor}DataCompressor\"><PolyData><Piece NumberOfPoints=\"{points}\"><Points>\
         <DataArray type=\"{}\" Name=\"Points\" NumberOfComponents=\"3\" format=\"appended\" offset=\"0\"/>\
         </Points></Piece></PolyData><AppendedData encoding=\"raw\">_",
        kinds[kind]
    )
    .into_bytes();
    file.extend(lengths.iter().flat_map(|length| length.to_le_bytes()));
    file.extend(whole.concat());
    file.extend(b"</AppendedData></VTKFile>");
    let read = vtp::read_particles(own(&file), memory());
    // The reader must accept an undamaged file.
    if count == 0 && data.len() == 3 * points * sizes[kind] && !data.is_empty() {
        assert!(read.is_ok(), "{:?}", read.err());
    }
    read_through(read);
}

fn zlib(block: &[u8]) -> Vec<u8> {
    use std::io::Write;
    let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(block).unwrap();
    encoder.finish().unwrap()
}

fn blocks() -> Vec<Vec<u8>> {
    let raw = build::raw(&build::tuples(3));
    [
        [0, 3, 16, 0, 0, 0, 0, 0],
        [0, 3, 16, 130, 1, 0, 0, 0],
        [5, 3, 36, 0, 0, 0, 0, 0],
        [6, 3, 16, 0, 0, 0, 0, 0],
        [12, 3, 36, 0, 0, 0, 0, 0],
    ]
    .map(|head: [u8; 8]| [&head[..], &raw].concat())
    .to_vec()
}

/// Gets the `info` of a file on disk, which the library opens as it does for the program. Also lists
/// the steps of the file and reads its frame 0. The first byte selects the extension.
fn run_info(data: &[u8]) {
    let Some((choice, data)) = data.split_first() else { return };
    let names = [
        "a.ply",
        "a.vtk",
        "a.vtp",
        "a.pvtp",
        "a.pvtu",
        "a.vtkhdf",
        "a.npy",
        "a.bi4",
        "a.mnf",
        "a.obj",
        "a.stl",
        "a.csv",
        "a.pvd",
        "a.vtp.series",
        "a.vtm",
    ];
    let path = folder::file(names[usize::from(*choice) % names.len()], data);
    if let Err(error) = files::info(&path) {
        assert!(!error.to_string().is_empty());
    }
    let _ = steps(&path, None);
    let frame = open_particles(Path::new(&format!("{}#0", path.display())), memory());
    read_through(frame.map_err(|error| error.fault));
}

fn infos() -> Vec<Vec<u8>> {
    let list = "<VTKFile type=\"PPolyData\" version=\"1.0\"><PPolyData><Piece Source=\"a.vtp\"/><Piece Source=\"../a.vtp\"/></PPolyData></VTKFile>";
    let first = |mut files: Vec<Vec<u8>>| files.swap_remove(0);
    let files = [
        first(meshes::plys()),
        first(meshes::vtks()),
        first(particles::vtus()),
        list.into(),
        list.into(),
    ];
    let mut all: Vec<_> =
        (0_u8..).zip(files).map(|(kind, file)| [&[kind][..], &file].concat()).collect();
    all.push([&[6][..], &first(particles::npys())].concat());
    let lists = [
        "<VTKFile type=\"Collection\"><Collection><DataSet timestep=\"0.5\" part=\"1\" file=\"a.vtp\"/>\
         <DataSet timestep=\"0.5\" part=\"0\" file=\".\\a.vtk\"/><DataSet file=\"a%20.csv\"/>\
         </Collection></VTKFile>",
        "{\"file-series-version\": \"1.0\", \"files\": [{\"name\": \"a.vtp\", \"time\": 0.5}]}",
        "<VTKFile type=\"vtkMultiBlockDataSet\"><vtkMultiBlockDataSet><Block index=\"0\">\
         <DataSet index=\"0\" name=\"b\" file=\"a.vtp\"/></Block><DataSet file=\"a.vtm\"/>\
         </vtkMultiBlockDataSet></VTKFile>",
    ];
    all.extend((12_u8..).zip(lists).map(|(kind, list)| [&[kind][..], list.as_bytes()].concat()));
    all
}
