//! Reads lists of frames: ParaView's .pvd collections and .series files, which name the files and
//! the time of each frame.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::Deserialize;

use crate::system::reopened::FileStamp;

use super::blocks::open_blocks;
use super::bytes::{LastFile, Unpacking, open_whole};
use super::input::open_wanted;
use super::listed::resolved;
use super::scan::mark_length;
use super::vtp::each_tag;
use super::wanted::WantedParticles;
use super::{ParticleFile, ReadError, ReadFault, malformed};

/// A frame that a list contains.
#[derive(Debug, Clone, PartialEq)]
pub struct ListedFrame {
    /// The time, if the list contains it.
    pub time: Option<f64>,
    /// The data sets of this frame. Those of a .pvd file are sorted by the attribute `part`. Those
    /// of a .series file are in list order.
    pub blocks: Vec<FrameBlock>,
}

/// A data set of a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameBlock {
    /// The file.
    pub file: PathBuf,
    /// The name, if the list contains it.
    pub name: Option<String>,
}

impl ListedFrame {
    /// The files of the data sets.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        self.blocks.iter().map(|block| &*block.file)
    }
}

/// Whether `path` has the extension of a list of frames.
pub fn is_list(path: &Path) -> bool {
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
    matches!(extension.as_deref(), Some("pvd" | "series"))
}

/// The frames in a list, in list order. Data sets with the same time are parts of one frame.
///
/// # Errors
/// [`ReadError`] for a list that cannot be read, is empty, or contains another list.
pub fn listed(path: &Path) -> Result<Arc<[ListedFrame]>, ReadError> {
    // Cache the last list, because the list is needed again for each of its frames.
    static LAST: LastFile<Arc<[ListedFrame]>> = LastFile::new();
    let Ok(metadata) = path.metadata() else { return read_list(path).map(Into::into) };
    let stamp = FileStamp::of(&metadata);
    if let Some(frames) = LAST.get(path, stamp) {
        return Ok(frames);
    }
    let frames: Arc<[ListedFrame]> = read_list(path)?.into();
    LAST.keep(path, stamp, Arc::clone(&frames));
    Ok(frames)
}

fn read_list(path: &Path) -> Result<Vec<ListedFrame>, ReadError> {
    let bytes = open_whole(path)?;
    let bytes = &bytes[mark_length(&bytes)..];
    let is_xml = bytes.trim_ascii_start().starts_with(b"<");
    let folder = path.parent().unwrap_or(Path::new(""));
    let frames = if is_xml { collection(bytes, folder) } else { series(bytes, folder) };
    let frames = frames.map_err(|fault| ReadError::new(path, fault))?;
    let other = frames.iter().flat_map(ListedFrame::files).find(|file| is_list(file));
    let fault = match other.map(Path::to_owned) {
        Some(other) => {
            format!(
                "the list names another list, {}; a list must name only data files",
                other.display()
            )
        }
        None if frames.is_empty() => "the list names no files".to_owned(),
        None => return Ok(frames),
    };
    Err(ReadError::new(path, malformed(0, fault)))
}

/// Opens frame number `number` of a list. Without a number, the list must have a single frame. If
/// the frame has several data sets, leaves out those without particles. Also leaves out data sets
/// of lines if another data set contains particles.
///
/// # Errors
/// [`ReadError`] if the list or a file of the frame cannot be read, and [`ReadFault::Unsupported`]
/// if no frame has this number, or if the list has several frames and `number` is `None`.
pub fn open_particles(
    path: &Path,
    list: &Path,
    number: Option<u64>,
    wanted: WantedParticles,
    unpacking: Unpacking,
) -> Result<ParticleFile, ReadError> {
    let ListedFrame { time, blocks } = frame_of(path, list, number)?;
    let opened = match &blocks[..] {
        [only] => open_wanted(&only.file, wanted, unpacking)?,
        blocks => open_blocks(path, blocks, wanted, unpacking)?,
    };
    Ok(ParticleFile { time: time.or(opened.time), ..opened })
}

/// Frame number `number` of `list`. Without a number, the list must have a single frame. `path` is
/// the path of the input, such as `sim.pvd#3`, for an error about the number.
///
/// # Errors
/// The errors of [`open_particles`] about the list and the number.
pub fn frame_of(path: &Path, list: &Path, number: Option<u64>) -> Result<ListedFrame, ReadError> {
    let frames = listed(list)?;
    let count = frames.len();
    let number =
        number.or((count == 1).then_some(0)).and_then(|number| usize::try_from(number).ok());
    let Some(number) = number.filter(|number| *number < count) else {
        let what = format!(
            "lists {count} frames; choose one of {0}#0 to {0}#{1}, or convert all of them to a \
             folder or pattern",
            list.display(),
            count - 1
        );
        return Err(ReadError::new(path, ReadFault::Unsupported(what)));
    };
    Ok(frames[number].clone())
}

/// Parses the entries of a .pvd file in `folder`.
fn collection(bytes: &[u8], folder: &Path) -> Result<Vec<ListedFrame>, ReadFault> {
    let mut sets: Vec<(Option<f64>, i64, FrameBlock)> = Vec::new();
    each_tag(bytes, |tag, _| {
        if tag.tag.name().as_ref() == "DataSet" {
            let file = tag.value("file")?.filter(|file| !file.is_empty());
            let file =
                file.ok_or_else(|| malformed(tag.at, "a <DataSet> has no attribute `file`"))?;
            let time: Option<f64> = tag.number("timestep")?;
            if time.is_some_and(|time| !time.is_finite()) {
                return Err(malformed(tag.at, "a timestep is not finite"));
            }
            let name = tag.value("name")?.filter(|name| !name.is_empty());
            let block = FrameBlock { file: resolved(folder, &file), name };
            sets.push((time, tag.number("part")?.unwrap_or(0), block));
        }
        Ok(())
    })?;
    let mut places = HashMap::new();
    let mut frames: Vec<ListedFrame> = Vec::new();
    let mut parts: Vec<(usize, i64, FrameBlock)> = Vec::new();
    for (time, part, block) in sets {
        let place = *places.entry(time.map(f64::to_bits)).or_insert(frames.len());
        if place == frames.len() {
            frames.push(ListedFrame { time, blocks: Vec::new() });
        }
        parts.push((place, part, block));
    }
    parts.sort_by_key(|(place, part, _)| (*place, *part));
    parts.into_iter().for_each(|(place, _, block)| frames[place].blocks.push(block));
    Ok(frames)
}

#[derive(Deserialize)]
struct FileSeries {
    files: Vec<FileOfSeries>,
}

#[derive(Deserialize)]
struct FileOfSeries {
    name: String,
    time: Option<f64>,
}

/// Parses the entries of a .series file in `folder`.
fn series(bytes: &[u8], folder: &Path) -> Result<Vec<ListedFrame>, ReadFault> {
    let series: FileSeries = serde_json::from_slice(bytes)
        .map_err(|fault| ReadFault::Line { line: fault.line() as u64, what: fault.to_string() })?;
    // If all times are equal, they are placeholders, not times.
    let mut times: Vec<u64> =
        series.files.iter().filter_map(|file| file.time).map(f64::to_bits).collect();
    times.sort_unstable();
    times.dedup();
    let has_times = times.len() > 1;
    let (mut frames, mut places) = (Vec::new(), HashMap::new());
    for FileOfSeries { name, time } in series.files {
        let next = frames.len();
        let known = time.filter(|_| has_times);
        let place = known.map_or(next, |time| *places.entry(time.to_bits()).or_insert(next));
        if place == next {
            frames.push(ListedFrame { time, blocks: Vec::new() });
        }
        frames[place].blocks.push(FrameBlock { file: resolved(folder, &name), name: None });
    }
    Ok(frames)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn listed_in(name: &str, text: &str, files: &[&str]) -> Result<Vec<ListedFrame>, ReadError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        for file in files {
            std::fs::create_dir_all(folder.path().join(file).parent().unwrap()).unwrap();
            std::fs::write(folder.path().join(file), "").unwrap();
        }
        let mut frames = listed(&path)?.to_vec();
        for block in frames.iter_mut().flat_map(|frame| &mut frame.blocks) {
            block.file = block.file.strip_prefix(folder.path()).unwrap().to_owned();
        }
        Ok(frames)
    }

    fn frame(time: impl Into<Option<f64>>, files: &[&str]) -> ListedFrame {
        let block = |file: &&str| FrameBlock { file: file.into(), name: None };
        ListedFrame { time: time.into(), blocks: files.iter().map(block).collect() }
    }

    #[test]
    fn equal_time_steps_are_one_frame_and_windows_and_url_paths_are_read() {
        let list = r#"<VTKFile type="Collection"><Collection>
            <DataSet timestep="0.5" group="" part="1" file="b%20c.vtp"/>
            <DataSet timestep="0.5" part="0" file="d\a.vtp"/>
            <DataSet timestep="0.25" file="100%25.vtp"/>
            </Collection></VTKFile>"#;
        let frames = listed_in("s.pvd", list, &["b c.vtp", "d/a.vtp", "100%25.vtp"]).unwrap();
        assert_eq!(frames, [frame(0.5, &["d/a.vtp", "b c.vtp"]), frame(0.25, &["100%25.vtp"])]);
        let series = r#"{"file-series-version": "1.0",
            "files": [{"name": "a.vtp", "time": 1}, {"name": "b.vtp"}, {"name": "c.vtp"},
                {"name": "d.vtp", "time": 1}, {"name": "e.vtp", "time": 2}]}"#;
        let frames = listed_in("s.vtp.series", series, &[]).unwrap();
        let expected = [&["a.vtp", "d.vtp"][..], &["b.vtp"], &["c.vtp"], &["e.vtp"]];
        let times = [Some(1.0), None, None, Some(2.0)];
        assert_eq!(frames, [0, 1, 2, 3].map(|i| frame(times[i], expected[i])));
        let equal = r#"{"files": [{"name": "a", "time": 0}, {"name": "b", "time": 0}]}"#;
        let frames = listed_in("equal.vtp.series", equal, &[]).unwrap();
        assert_eq!(frames, [frame(0.0, &["a"]), frame(0.0, &["b"])]);
        for (name, list) in [("s.pvd", list), ("s.vtp.series", series)] {
            let marked = listed_in(name, &format!("\u{feff}{list}"), &["b c.vtp"]).unwrap();
            assert_eq!(marked, listed_in(name, list, &["b c.vtp"]).unwrap());
        }
    }

    #[test]
    fn truncated_empty_and_recursive_lists_are_refused() {
        for (name, text) in [
            ("s.pvd", ""),
            ("s.pvd", "<VTKFile><Collection><DataSet file=\"a.vtp\"/>"),
            ("s.pvd", "<VTKFile><Collection></Collection></VTKFile>"),
            ("s.pvd", "<VTKFile><DataSet timestep=\"1\"/></VTKFile>"),
            ("s.pvd", "<VTKFile><DataSet timestep=\"nan\" file=\"a.vtp\"/></VTKFile>"),
            ("s.pvd", "<VTKFile><DataSet file=\"s.pvd\"/></VTKFile>"),
            ("s.vtp.series", "{\"files\": [{\"name\": \"a.vtp\"}"),
            ("s.vtp.series", "{\"files\": []}"),
        ] {
            listed_in(name, text, &[]).unwrap_err();
        }
    }
}
