//! Pictures of mesh files with a common camera: one for each mesh, a contact sheet, or an
//! animation.

use std::fmt;
use std::fs::File;
use std::io::BufReader;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::thread::available_parallelism;

use crate::error::{Error, SimulationError};
use crate::io::collection::{ListedFrame, frame_of, is_list, listed};
use crate::io::input::InputFormat;
use crate::io::input::file_and_step;
use crate::io::output::{MeshFormat, OpenedMesh, open_mesh};
use crate::io::series::listed_meshes;
use crate::io::stamp::is_same_file;
use crate::io::up::recorded_up;
use crate::io::whole::{MadeFolders, Replace, WholeFile};
use crate::io::{UpAxis, WriteError, WriteFault};
use crate::reconstruction::Threads;
use crate::surface::picture::{Animation, Image, Picture, PictureError, Scope, source_of_png};
use crate::system::cancel::{Cancel, UnfinishedOutput};

use super::builder::Simulation;
use super::frame_file::FrameFile;
use super::inputs::{Inputs, Sequence, files_in};
use super::naming::{self, Naming, without_number};
use super::pattern::stem;
use super::small_meshes::SmallMeshes;
use super::state::StateFolder;

const PNG: &str = "png";
const APNG: &str = "apng";
const KNOWN: &str = ".png, and .apng for an animation";
/// Width and height, in pixels, of a picture on a contact sheet.
const SHEET_PICTURE_SIZE: [usize; 2] = [640, 360];
const ANIMATION_SIZE: [usize; 2] = [960, 540];
/// Maximum number of pictures on a sheet. If there are more meshes, an evenly spaced selection of
/// them is drawn.
const MOST_ON_SHEET: usize = 24;
const COLUMNS: usize = 4;
/// Default number of pictures per second of an animation.
const FPS: f64 = 24.0;

/// A request for pictures of meshes in files.
///
/// One mesh gives one picture. For several meshes, the output is a folder or a pattern with `{}`
/// for one picture of each mesh, an `.apng` for an animation, or a `.png` for a contact sheet. All
/// pictures have the same range of values, and the same camera, which has all meshes in view.
#[derive(Debug, Clone)]
#[must_use]
pub struct Pictures {
    picture: Picture,
    meshes: Vec<PathBuf>,
    /// The meshes in order, if they are already known.
    frames: Option<Vec<FrameFile>>,
    output: PathBuf,
    /// The text that is stored in the file of a sheet, and names the meshes.
    source: Option<String>,
    sized: bool,
    fps: f64,
    replace: Replace,
    threads: Option<usize>,
    memory: Option<u64>,
    cancel: Cancel,
}

/// A prepared file for pictures, such as a `.png`, that is written completely or not at all.
#[derive(Debug)]
pub struct PictureFile {
    file: WholeFile,
    #[expect(dead_code, reason = "dropped after the file")]
    folders: MadeFolders,
    #[expect(dead_code, reason = "dropped after the file")]
    unfinished: UnfinishedOutput,
}

impl PictureFile {
    /// Checks that a picture can be written, before any picture is drawn. [`Cancel::abandon`]
    /// removes the temporary file if the picture is not complete.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn prepare(
        path: impl AsRef<Path>,
        replace: Replace,
        cancel: &Cancel,
    ) -> Result<Self, Error> {
        let path = path.as_ref();
        let prepared = Self::of_pictures(path, replace, cancel)?;
        match extension(path) == PNG || prepared.file.is_direct() {
            true => Ok(prepared),
            false => {
                Err(WriteError::new(path, WriteFault::UnknownExtension { known: ".png" }).into())
            }
        }
    }

    /// Prepares a file of any extension.
    fn of_pictures(path: &Path, replace: Replace, cancel: &Cancel) -> Result<Self, WriteError> {
        let prepare = || {
            let folders = MadeFolders::of(path)?;
            Ok((WholeFile::prepare(path, replace)?, folders))
        };
        let ((file, folders), unfinished) =
            cancel.guard(prepare, |(file, folders)| file.leftovers(folders))?;
        Ok(Self { file, folders, unfinished })
    }

    /// Checks that a picture can be written next to a mesh, before the picture is drawn. The
    /// picture has the name of the mesh, with the extension `.png`.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn beside(
        mesh: impl AsRef<Path>,
        replace: Replace,
        cancel: &Cancel,
    ) -> Result<Self, Error> {
        Self::prepare(mesh.as_ref().with_extension(PNG), replace, cancel)
    }

    /// The file.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.file.path()
    }

    /// Writes the picture, and returns the file's size in bytes.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn write(self, image: &Image) -> Result<u64, Error> {
        self.write_of(image, None)
    }

    /// Writes the picture with `source`, a text that names its meshes.
    fn write_of(self, image: &Image, source: Option<&str>) -> Result<u64, Error> {
        Ok(self.file.write(|out| image.write_png_of(out, source))?)
    }
}

/// A finished picture.
#[derive(Debug, Clone, Copy)]
#[non_exhaustive]
pub struct PictureDone<'a> {
    /// The mesh.
    pub mesh: &'a Path,
    /// The file of the picture. A sheet or an animation is complete when all its pictures are
    /// finished.
    pub output: &'a Path,
    /// Number of finished pictures.
    pub done: usize,
    /// Number of all pictures.
    pub all: usize,
}

/// Valid frame rates of an animation, in pictures per second.
const RATES: RangeInclusive<f64> = 0.1..=1000.0;

/// The output of the pictures.
enum PictureTarget {
    One(PictureFile),
    Each(Vec<PathBuf>),
    Sheet(PictureFile),
    Animation(PictureFile),
}

impl Pictures {
    /// A request for pictures of files, a folder, a glob, or a pattern with `{}` for the frame
    /// number. If the picture does not set the up axis, the pictures use the up axis of the first
    /// mesh whose file or list of frames records one, or y if no up axis is recorded.
    pub fn new<I: Into<PathBuf>>(
        picture: Picture,
        meshes: impl IntoIterator<Item = I>,
        output: impl Into<PathBuf>,
    ) -> Self {
        Self {
            picture,
            meshes: meshes.into_iter().map(Into::into).collect(),
            frames: None,
            output: output.into(),
            source: None,
            sized: false,
            fps: FPS,
            replace: Replace::Refuse,
            threads: None,
            memory: None,
            cancel: Cancel::new(),
        }
    }

    /// Sets the width and height in pixels. The default is 1920 x 1080, 960 x 540 in an animation,
    /// and 640 x 360 on a sheet.
    pub fn size(mut self, width: usize, height: usize) -> Self {
        self.picture = self.picture.size(width, height);
        self.sized = true;
        self
    }

    /// Sets the pictures per second of an animation. The default is 24.
    pub fn fps(mut self, rate: f64) -> Self {
        self.fps = rate;
        self
    }

    /// Sets whether existing files may be replaced.
    pub fn replace(mut self, replace: Replace) -> Self {
        self.replace = replace;
        self
    }

    /// Sets the number of threads. The default is one per core.
    pub fn threads(mut self, count: usize) -> Self {
        self.threads = Some(count);
        self
    }

    /// Limits the memory, in bytes, of a mesh and its picture. A `.ply` file from this library that
    /// needs more than half of this memory is streamed.
    pub fn memory(mut self, bytes: u64) -> Self {
        self.memory = Some(bytes);
        self
    }

    /// Sets a handle that can cancel the work.
    pub fn cancel(mut self, cancel: Cancel) -> Self {
        self.cancel = cancel;
        self
    }

    /// Draws and writes the pictures, and calls `report` for each of them.
    ///
    /// # Errors
    /// [`Error::Request`], [`Error::Simulation`], [`Error::Read`], [`Error::Picture`],
    /// [`Error::Write`], [`Error::SameFile`], [`Error::Threads`] and [`Error::Cancelled`].
    pub fn run(mut self, report: impl FnMut(PictureDone<'_>) + Send) -> Result<(), Error> {
        self.picture.check().map_err(|fault| Error::Picture { path: None, fault })?;
        if !RATES.contains(&self.fps) {
            return Err(SimulationError::Rate { rate: self.fps, range: RATES }.into());
        }
        let threads =
            self.threads.or_else(|| available_parallelism().ok().map(Into::into)).unwrap_or(1);
        let pool = Threads::start(threads).map_err(Error::Threads)?;
        let (sequence, mut frames) = match self.frames.take() {
            Some(frames) => (None, frames),
            None => self.frames()?,
        };
        let default_up =
            || frames.iter().find_map(|frame| recorded_up(&frame.path)).unwrap_or(UpAxis::Y);
        self.picture = self.picture.up_unless_set(default_up);
        let target = self.target(sequence.as_ref(), &frames)?;
        let size = match target {
            PictureTarget::Sheet(_) => {
                let all = frames.len();
                if all > MOST_ON_SHEET {
                    let chosen = (0..MOST_ON_SHEET).map(|n| n * (all - 1) / (MOST_ON_SHEET - 1));
                    frames = chosen.map(|n| frames[n].clone()).collect();
                }
                Some(SHEET_PICTURE_SIZE)
            }
            PictureTarget::Animation(_) => Some(ANIMATION_SIZE),
            PictureTarget::One(_) | PictureTarget::Each(_) => None,
        };
        if let Some([width, height]) = size.filter(|_| !self.sized) {
            self.picture = self.picture.size(width, height);
        }
        pool.install(|| self.draw(&frames, target, report))
    }

    /// The meshes in order, with their sequence if they form one.
    fn frames(&self) -> Result<(Option<Sequence>, Vec<FrameFile>), Error> {
        if let [mesh] = &self.meshes[..]
            && is_list(file_and_step(mesh).0)
        {
            return Ok((None, in_list(mesh)?));
        }
        let inputs = if let [mesh] = &self.meshes[..]
            && mesh.is_dir()
        {
            // The folder may contain other files.
            let files = files_in(mesh, |file| {
                MeshFormat::of(file).is_some() || InputFormat::of(file) == Some(InputFormat::Bgeo)
            })?;
            match &files[..] {
                [] => return Err(SimulationError::NoFiles(mesh.display().to_string()).into()),
                [file] => return Ok((None, vec![single_mesh(file)])),
                _ => Inputs::Files(files),
            }
        } else {
            match (Inputs::of(&self.meshes, None)?, &self.meshes[..]) {
                (Some(inputs), [_, ..]) => inputs,
                (_, [mesh]) => return Ok((None, vec![single_mesh(mesh)])),
                _ => return Err(Error::Request("no mesh file; name at least one".into())),
            }
        };
        match inputs.only() {
            Ok((sequence, frames)) => Ok((Some(sequence), frames)),
            Err(SimulationError::NoFrames(given)) if matches!(inputs, Inputs::Files(_)) => {
                Err(SimulationError::NoFiles(given).into())
            }
            Err(error) => Err(error.into()),
        }
    }

    /// Checks that the pictures can be written.
    fn target(
        &self,
        sequence: Option<&Sequence>,
        frames: &[FrameFile],
    ) -> Result<PictureTarget, Error> {
        let fail = |path: &Path, fault| Error::from(WriteError::new(path, fault));
        let output = &self.output;
        if let Some(naming) = Naming::of(output)? {
            if let Naming::Pattern(pattern) = &naming
                && extension(Path::new(&pattern.suffix)) != PNG
            {
                return Err(fail(output, WriteFault::UnknownExtension { known: ".png" }));
            }
            let named = |frame: &FrameFile| {
                let picture = match (&naming, sequence) {
                    (_, Some(sequence)) => {
                        naming.outputs(sequence).path(frame.number, &frame.digits)
                    }
                    (Naming::Pattern(pattern) | Naming::Archive { frames: pattern, .. }, None) => {
                        pattern.path(frame.number, &frame.digits)
                    }
                    (Naming::Folder(folder), None) => {
                        folder.join(frame.path.file_name().unwrap_or_default())
                    }
                };
                picture.with_extension(PNG)
            };
            let files: Vec<PathBuf> = frames.iter().map(named).collect();
            for file in &files {
                self.refuse_inputs(frames, file)?;
                // The prepared file is not kept, because this loop only checks that the file can be
                // written.
                drop(PictureFile::prepare(file, self.replace, &self.cancel)?);
            }
            return Ok(PictureTarget::Each(files));
        }
        self.refuse_inputs(frames, output)?;
        let file = PictureFile::of_pictures(output, self.replace, &self.cancel)?;
        match extension(output) {
            APNG if frames.len() > 1 => Ok(PictureTarget::Animation(file)),
            APNG => Err(Error::Request(format!(
                "{}: an animation needs several meshes",
                output.display()
            ))),
            _ if extension(output) != PNG && !file.file.is_direct() => {
                Err(fail(output, WriteFault::UnknownExtension { known: KNOWN }))
            }
            _ if frames.len() > 1 => Ok(PictureTarget::Sheet(file)),
            _ => Ok(PictureTarget::One(file)),
        }
    }

    fn refuse_inputs(&self, frames: &[FrameFile], output: &Path) -> Result<(), Error> {
        match frames.iter().find(|frame| is_same_file(&frame.path, output)) {
            Some(frame) => {
                Err(Error::SameFile { path: output.to_owned(), other: frame.path.clone() })
            }
            None => Ok(()),
        }
    }

    fn draw(
        mut self,
        frames: &[FrameFile],
        target: PictureTarget,
        mut report: impl FnMut(PictureDone<'_>) + Send,
    ) -> Result<(), Error> {
        if frames.len() > 1 {
            self.picture = self.picture.clone().scope(self.scope(frames)?);
        }
        let output = self.output.clone();
        let mut drawn = frames.iter().enumerate().map(|(n, frame)| {
            let image = self.image(frame)?;
            Ok::<_, Error>((n, frame, image))
        });
        let mut done = |n: usize, frame: &FrameFile, output: &Path| {
            report(PictureDone { mesh: &frame.path, output, done: n + 1, all: frames.len() });
        };
        match target {
            PictureTarget::One(file) => {
                if let Some(next) = drawn.next() {
                    let (n, frame, image) = next?;
                    file.write_of(&image, self.source.as_deref())?;
                    done(n, frame, &output);
                }
            }
            PictureTarget::Each(files) => {
                for next in drawn {
                    let (n, frame, image) = next?;
                    PictureFile::prepare(&files[n], self.replace, &self.cancel)?.write(&image)?;
                    done(n, frame, &files[n]);
                }
            }
            PictureTarget::Sheet(file) => {
                let mut images = Vec::with_capacity(frames.len());
                for next in drawn {
                    let (n, frame, image) = next?;
                    images.push(image.labelled(&frame.digits));
                    done(n, frame, &output);
                }
                let sheet = Image::sheet(&images, COLUMNS);
                let source = self.source.as_deref();
                file.file.write(|out| {
                    sheet.as_ref().map_or(Ok(()), |sheet| sheet.write_png_of(out, source))
                })?;
            }
            PictureTarget::Animation(file) => {
                // An error while drawing is returned as it is, not as an error of the output file.
                let mut fault = None;
                let written = file.file.write(|out| {
                    let mut animation: Option<Animation<'_>> = None;
                    let mut out = Some(out);
                    for next in drawn.by_ref() {
                        let (n, frame, image) = match next {
                            Ok(next) => next,
                            Err(error) => {
                                fault = Some(error);
                                return Err(std::io::ErrorKind::Interrupted.into());
                            }
                        };
                        let started = match (animation.take(), out.take()) {
                            (Some(animation), _) => Some(animation),
                            (None, Some(out)) => {
                                Some(Animation::begin(out, &image, frames.len() as u32, self.fps)?)
                            }
                            (None, None) => None,
                        };
                        animation = started;
                        if let Some(animation) = &mut animation {
                            animation.push(&image)?;
                        }
                        done(n, frame, &output);
                    }
                    animation.map_or(Ok(()), Animation::end)
                });
                match fault {
                    Some(fault) => return Err(fault),
                    None => written.map(drop)?,
                }
            }
        }
        Ok(())
    }

    /// Returns the bounding box and the range of values of all meshes together.
    fn scope(&self, frames: &[FrameFile]) -> Result<Scope, Error> {
        let mut scope = Scope::default();
        for frame in frames {
            let mesh = self.read(frame)?;
            let of_mesh =
                self.picture.scope_of(mesh.source()).map_err(|fault| of_file(frame, fault))?;
            scope = scope.joined(of_mesh);
        }
        Ok(scope)
    }

    fn image(&self, frame: &FrameFile) -> Result<Image, Error> {
        let mesh = self.read(frame)?;
        let mesh_bytes = match &mesh {
            OpenedMesh::Whole(mesh) => mesh.bytes(),
            OpenedMesh::Streamed(_) => 0,
        };
        let picture = match self.memory {
            Some(memory) => self.picture.clone().memory(memory.saturating_sub(mesh_bytes)),
            None => self.picture.clone(),
        };
        picture.draw(mesh.source()).map_err(|fault| of_file(frame, fault))
    }

    /// Opens a mesh. A mesh that would need more than half of the memory limit may be streamed.
    fn read(&self, frame: &FrameFile) -> Result<OpenedMesh, Error> {
        if self.cancel.is_cancelled() {
            return Err(Error::Cancelled);
        }
        Ok(open_mesh(&frame.path, self.memory.map_or(u64::MAX, |memory| memory / 2))?)
    }
}

/// The meshes in a list of frames. If `path` ends with `#` and a number, only the mesh with this
/// number.
fn in_list(path: &Path) -> Result<Vec<FrameFile>, Error> {
    let (list, step) = file_and_step(path);
    let frames = match step {
        Some(_) => vec![frame_of(path, list, step)?],
        None => listed(list)?.to_vec(),
    };
    let frame = |(number, frame): (i64, ListedFrame)| match &frame.blocks[..] {
        [mesh] => Ok(FrameFile::new(number, number.to_string(), mesh.file.clone())),
        blocks => Err(Error::Request(format!(
            "{}#{number}: this frame is in {} files; a picture shows one mesh, so name one file",
            list.display(),
            blocks.len()
        ))),
    };
    (step.unwrap_or(0) as i64..).zip(frames).map(frame).collect()
}

/// The frame for a single mesh file, whose name need not contain a number.
fn single_mesh(path: &Path) -> FrameFile {
    FrameFile::new(0, String::new(), path.to_owned())
}

fn of_file(frame: &FrameFile, fault: PictureError) -> Error {
    Error::Picture { path: Some(frame.path.clone()), fault }
}

fn extension(path: &Path) -> &'static str {
    let name = path.to_string_lossy().to_ascii_lowercase();
    [PNG, APNG].into_iter().find(|known| name.ends_with(&format!(".{known}"))).unwrap_or("")
}

/// A contact sheet of a simulation's frames, drawn when their meshes exist.
#[derive(Debug)]
#[must_use]
pub struct Sheet {
    pictures: Pictures,
    path: PathBuf,
    overwrite: bool,
    resume: bool,
    inputs: Inputs,
    naming: Naming,
    /// The small meshes of all frames, if the format of the frames' own meshes cannot be read.
    small: Option<SmallMeshes>,
}

/// A finished contact sheet. `Display` prints it as one line.
#[derive(Debug, Clone)]
#[non_exhaustive]
#[must_use = "meshes may be missing from the sheet"]
pub struct SheetDone {
    /// The picture's file; it does not exist if no mesh could be drawn.
    pub path: PathBuf,
    /// Number of meshes to draw.
    pub meshes: usize,
    /// Meshes that are not on the sheet, because their format cannot be read and the run that made
    /// them stored no small meshes.
    pub undrawn: Vec<PathBuf>,
}

impl SheetDone {
    /// A warning about meshes that are missing from the sheet, if there are any.
    #[must_use]
    pub fn warning(&self) -> Option<String> {
        let (first, last) = (self.undrawn.first()?, self.undrawn.last()?);
        let (which, them) = match self.undrawn.len() {
            1 => (first.display().to_string(), "it"),
            count => {
                let which = format!("{} to {} ({count} meshes)", first.display(), last.display());
                (which, "them")
            }
        };
        Some(format!(
            "{which}: missing from the contact sheet, because an earlier run made {them} without a \
             contact sheet, and meniscus cannot read meshes of this format; make {them} again to \
             include {them}"
        ))
    }
}

impl fmt::Display for SheetDone {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { path, meshes, undrawn } = self;
        match meshes - undrawn.len() {
            0 => write!(f, "{}: no contact sheet, because no frame could be drawn", path.display()),
            _ if undrawn.is_empty() => {
                write!(f, "{}: a contact sheet of the frames", path.display())
            }
            drawn => write!(f, "{}: a contact sheet of {drawn} of {meshes} frames", path.display()),
        }
    }
}

impl Simulation {
    /// Checks that a contact sheet can be written next to the meshes, before any mesh is made. The
    /// sheet has the name of the meshes without numbers. If nothing is left of this name, or if the
    /// output is a folder, the sheet is called `frames.png`. An existing file is replaced if the
    /// simulation may overwrite its outputs, or if it resumes and the file is a sheet of its
    /// meshes.
    ///
    /// If this library cannot read the format of the meshes, [`run`](Self::run) then stores a small
    /// mesh of each frame next to the state, for this run and for runs that resume it.
    ///
    /// # Errors
    /// [`Error::Write`] if the sheet cannot be written, [`Error::SameFile`] if the caller writes to
    /// the same file as the sheet, [`Error::Request`] if the output is an archive, and
    /// [`Error::Simulation`] for names that do not determine frame numbers.
    pub fn sheet(&mut self) -> Result<Sheet, Error> {
        let path = sheet_path(&self.output);
        if let Some(other) = self.also_written.iter().find(|other| is_same_file(other, &path)) {
            return Err(Error::SameFile { path: other.clone(), other: path });
        }
        let (inputs, naming) = self.names()?;
        if let Naming::Archive { path, .. } = naming {
            return Err(Error::Request(format!(
                "{}: cannot draw a contact sheet of one archive; write one file per frame, with \
                 {{}} for the frame number",
                path.display()
            )));
        }
        let simulations = || inputs.simulations(None).ok();
        let settings = &self.request.settings;
        let first = || simulations()?.first()?.list().ok()?.into_iter().next();
        let usual = || first().map_or(UpAxis::Y, |frame| settings.usual_up(&frame.path));
        let up = settings.up.or(settings.particles_up).unwrap_or_else(usual);
        let picture = Picture::new().up(up).ground(true);
        let pictures = Pictures::new(picture, [&self.output], &path);
        let pictures = pictures.cancel(self.request.control.cancel.clone());
        // Meshes in a folder are `.ply` files, which can be read, so they need no small meshes.
        let small = match &naming {
            Naming::Pattern(outputs)
                if MeshFormat::of(&self.output).is_some_and(|format| !format.is_read()) =>
            {
                let store = StateFolder::beside(&naming::simulation(outputs));
                Some(SmallMeshes::beside(store.folder()))
            }
            _ => None,
        };
        let (overwrite, resume) = (self.overwrite, self.resume);
        let sheet = Sheet { pictures, path, overwrite, resume, inputs, naming, small };
        if sheet.path.exists() {
            drop(PictureFile::prepare(&sheet.path, sheet.replace(), &sheet.pictures.cancel)?);
        }
        self.sheet = true;
        Ok(sheet)
    }
}

impl Sheet {
    /// The picture's file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The meshes in the lists of frames of all simulations. Other meshes next to them do not
    /// belong to this conversion.
    fn meshes(&self) -> Result<Vec<FrameFile>, Error> {
        let simulations = self.inputs.simulations(None)?;
        let mut meshes = Vec::new();
        for sequence in &simulations {
            let outputs = self.naming.outputs(sequence);
            for (number, file) in listed_meshes(&naming::simulation(&outputs)) {
                let label = match outputs.digits(&file) {
                    Some(digits) if simulations.len() == 1 => digits,
                    _ => stem(&file),
                };
                let label = label.to_owned();
                meshes.push(FrameFile::new(number, label, outputs.folder.join(file)));
            }
        }
        Ok(meshes)
    }

    /// Draws the contact sheet, with the meshes that the lists of frames contain.
    ///
    /// # Errors
    /// The errors of [`Pictures::run`], and [`Error::Simulation`] if the inputs can no longer be
    /// listed.
    pub fn draw(self) -> Result<SheetDone, Error> {
        let mut pictures = self.pictures.clone().replace(self.replace());
        pictures.source = Some(self.source());
        let mut drawn = self.meshes()?;
        let Self { path, small, .. } = self;
        let meshes = drawn.len();
        let mut undrawn = Vec::new();
        if let Some(small) = &small {
            for frame in std::mem::take(&mut drawn) {
                let path = small.path(frame.number);
                if path.is_file() {
                    drawn.push(FrameFile { path, ..frame });
                } else {
                    undrawn.push(frame.path);
                }
            }
        }
        if !drawn.is_empty() {
            pictures.frames = Some(drawn);
            pictures.run(|_| ())?;
        }
        Ok(SheetDone { path, meshes, undrawn })
    }

    /// Returns the text to store in the picture's file. It lists the names of the meshes.
    fn source(&self) -> String {
        let meshes = self.pictures.meshes.iter().filter_map(|output| output.file_name());
        let names: Vec<_> = meshes.map(|name| name.to_string_lossy()).collect();
        format!("a sheet of {}", names.join(", "))
    }

    /// Returns [`Replace::Allow`] if the sheet may replace an existing file. This is the case if
    /// outputs may be replaced, or if the conversion is resumed and the file is a sheet of its
    /// meshes.
    fn replace(&self) -> Replace {
        let is_own = || {
            let file = File::open(&self.path).ok();
            let source = file.and_then(|file| source_of_png(&mut BufReader::new(file)));
            source.is_some_and(|source| source == self.source())
        };
        if self.overwrite || self.resume && is_own() { Replace::Allow } else { Replace::Refuse }
    }
}

/// The path of the sheet, which is named after the meshes.
fn sheet_path(output: &Path) -> PathBuf {
    let is_folder = output.is_dir() || output.to_string_lossy().ends_with(std::path::is_separator);
    let stem = if is_folder { None } else { output.file_stem() };
    let stem = stem.map(|stem| stem.to_string_lossy().split('{').next().unwrap_or("").to_owned());
    let name = format!("{}.png", without_number(&stem.unwrap_or_default()));
    let folder = if is_folder { output } else { output.parent().unwrap_or(Path::new("")) };
    folder.join(name)
}
