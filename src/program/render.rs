//! `meniscus render`: pictures of meshes.

use std::path::PathBuf;
use std::str::FromStr;

use bytesize::ByteSize;
use clap::Args;
use clap::builder::ArgPredicate;
use meniscus::files::Replace;
use meniscus::mesh::read_mesh;
use meniscus::picture::{Colour, ColourMap, Picture, Pictures, Reference, View};
use meniscus::{Error, UpAxis, default_memory};

use super::interrupt;
use super::notes::Notes;
use super::notes::Verdict;

#[derive(Args)]
pub struct RenderOptions {
    /// Meshes: files, a folder, a glob, or a pattern with {} for the frame number.
    #[arg(required = true, value_name = "MESH")]
    meshes: Vec<PathBuf>,
    /// For one mesh: a .png. For several meshes: a folder or a pattern with {} (a picture of each
    /// mesh), an .apng (an animation), or a .png (a contact sheet).
    #[arg(short, long)]
    output: PathBuf,
    /// Width and height in pixels
    /// [default: 1920x1080; 960x540 in an animation, 640x360 on a sheet].
    #[arg(long, value_name = "WxH", value_parser = size)]
    size: Option<[usize; 2]>,
    /// Camera position [default: from the front and above, with everything in view].
    ///
    /// Two numbers are the camera's azimuth and elevation in degrees; an optional third number is a
    /// zoom factor. Six numbers are the position of the camera, and the point that it looks at.
    #[arg(long, value_name = "NUMBERS", value_delimiter = ',', allow_hyphen_values = true)]
    camera: Option<Vec<f64>>,
    /// Axis that points up [default: the axis in the mesh file or in the simulation's list of
    /// frames, else y].
    #[arg(long, value_enum)]
    up: Option<UpAxis>,
    /// Show the floor of the bounding box, with shadows.
    #[arg(long)]
    ground: bool,
    /// Show the edges of the triangles.
    #[arg(long)]
    wireframe: bool,
    /// Colour: water, a colour such as ff8800, an attribute such as velocity or velocity:turbo (with
    /// a colour map), or, with --reference, distance:red-blue.
    #[arg(long, visible_alias = "color", value_name = "COLOUR", default_value = "water", default_value_if("reference", ArgPredicate::IsPresent, "distance"), value_parser = colour)]
    colour: ColourArgument,
    /// Colour by the signed distance from this mesh, in the meshes' unit of length. Distances are
    /// negative inside this mesh.
    #[arg(long, value_name = "MESH")]
    reference: Option<PathBuf>,
    /// Frames per second of an animation.
    #[arg(long, value_name = "RATE")]
    fps: Option<f64>,
    /// Number of threads [default: one per core].
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// Memory limit for a mesh and its picture, such as 512MiB [default: three quarters of the
    /// available memory].
    #[arg(long, value_name = "SIZE")]
    memory: Option<ByteSize>,
    /// Replace existing pictures.
    #[arg(long)]
    overwrite: bool,
    /// Print only errors.
    #[arg(short, long)]
    quiet: bool,
}

/// Runs `meniscus render`.
pub fn run(options: &RenderOptions) -> Result<Verdict, Error> {
    let notes = Notes::new(options.quiet, false);
    let memory = options.memory.map_or_else(|| default_memory().0, |size| size.as_u64());
    let mut picture = Picture::new()
        .ground(options.ground)
        .wireframe(options.wireframe)
        .colour(options.colour()?);
    if let Some(up) = options.up {
        picture = picture.up(up);
    }
    if let Some(numbers) = &options.camera {
        picture = picture.view(view(numbers)?);
    }
    let mut pictures = Pictures::new(picture, &options.meshes, &options.output)
        .replace(if options.overwrite { Replace::Allow } else { Replace::Refuse })
        .memory(memory)
        .cancel(interrupt::handle());
    if let Some([width, height]) = options.size {
        pictures = pictures.size(width, height);
    }
    if let Some(fps) = options.fps {
        pictures = pictures.fps(fps);
    }
    if let Some(threads) = options.threads {
        pictures = pictures.threads(threads);
    }
    pictures.run(|done| {
        notes.say(format!(
            "{}: {} ({} of {})",
            done.output.display(),
            done.mesh.display(),
            done.done,
            done.all
        ));
    })?;
    Ok(Verdict::Good)
}

fn size(text: &str) -> Result<[usize; 2], String> {
    let both = text
        .split_once(['x', 'X'])
        .and_then(|(width, height)| Some([width.parse().ok()?, height.parse().ok()?]));
    both.ok_or_else(|| "expected a width and a height, such as 1920x1080".to_owned())
}

fn view(numbers: &[f64]) -> Result<View, Error> {
    match *numbers {
        [azimuth, elevation] => Ok(View::From { azimuth, elevation, zoom: 1.0 }),
        [azimuth, elevation, zoom] => Ok(View::From { azimuth, elevation, zoom }),
        [a, b, c, d, e, f] => Ok(View::At { eye: [a, b, c], target: [d, e, f] }),
        _ => {
            let what = "--camera must be two angles in degrees (azimuth and elevation) and \
                        optionally a zoom factor, or six numbers: the position of the camera, and \
                        the point that it looks at";
            Err(Error::Request(what.to_owned()))
        }
    }
}

/// A colour as given on the command line.
#[derive(Clone)]
enum ColourArgument {
    Colour(Colour),
    Named(String, Option<ColourMap>),
}

/// The value of `--colour` that colours by the distance from the reference mesh.
const DISTANCE: &str = "distance";

impl RenderOptions {
    fn colour(&self) -> Result<Colour, Error> {
        let (name, map) = match (&self.colour, &self.reference) {
            (ColourArgument::Named(name, map), Some(path)) if name == DISTANCE => {
                let mesh = read_mesh(path)?;
                let fail = |fault| Error::Picture { path: Some(path.clone()), fault };
                let from = Reference::new(&mesh).map_err(fail)?;
                return Ok(Colour::Distance {
                    from,
                    map: map.unwrap_or_else(ColourMap::diverging),
                });
            }
            (_, Some(path)) => {
                let what = format!("{}: --reference needs --colour {DISTANCE}", path.display());
                return Err(Error::Request(what));
            }
            (ColourArgument::Colour(colour), None) => return Ok(colour.clone()),
            (ColourArgument::Named(name, map), None) => (name.clone(), map.unwrap_or_default()),
        };
        Ok(Colour::Attribute { name, map })
    }
}

fn colour(text: &str) -> Result<ColourArgument, String> {
    if text == "water" {
        return Ok(ColourArgument::Colour(Colour::Water));
    }
    let digits = text.strip_prefix('#').unwrap_or(text);
    if digits.len() == 6
        && let Ok(rgb) = u32::from_str_radix(digits, 16)
    {
        return Ok(ColourArgument::Colour(Colour::Solid(
            [rgb >> 16, rgb >> 8, rgb].map(|channel| channel as u8),
        )));
    }
    let (name, map) = match text.rsplit_once(':') {
        Some((name, map)) => {
            (name, Some(ColourMap::from_str(map).map_err(|error| error.to_string())?))
        }
        None => (text, None),
    };
    Ok(ColourArgument::Named(name.to_owned(), map))
}
