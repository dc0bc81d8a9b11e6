//! A list of every error and warning with example values, in `tests/messages.txt`.
//!
//! If a message differs from its line in that file, the test fails. Set `MENISCUS_UPDATE=1` to
//! rewrite the file.

use std::fmt::{Display, Write as _};
use std::io;
use std::path::PathBuf;

use ash::vk;

use super::warning::{EmptyReason, Warning};
use super::{SpacingMistake, SpacingSource, SpacingWarning};
use crate::baselines::{KernelMethod, TooManyCells};
use crate::brick::{BinError, Census};
use crate::error::{
    ColourScale, CompareError, Conflict, DomainError, Error, FrameError, KindFault, NoEstimate,
    OverBudget, PartsError, PeriodicError, PictureError, ReadError, ReadFault, Remedy, RereadError,
    SelectionFault, Setting, SettingConflict, SimulationError, SizeFault, TooFine, UnitError,
    VulkanError, WholeMeshError, WhyOne, WriteError, WriteFault,
};
use crate::field::calibration::NoMeanCount;
use crate::field::indicator::IndicatorKind;
use crate::field::walls::{BeyondWall, GapAtWall};
use crate::frame::{CoincidentParticles, Shortfall};
use crate::grid::units::Isovalue;
use crate::io::UnreadPart;
use crate::io::glb::GlbLayout;
use crate::io::houdini::Primitives;
use crate::io::output::MeshFormat;
use crate::particles::mixture::Mixture;
use crate::particles::occurring::{Value, ValueCounts};
use crate::particles::{AttributeInfo, AttributeKind};
use crate::surface::mesh::compare::Side;
use crate::surface::simplify::TooSmall;
use crate::surface::solid::SolidFault;

fn section<T: Display>(text: &mut String, name: &str, examples: &[(&str, T)]) {
    let _ = writeln!(text, "\n{name}");
    for (variant, example) in examples {
        let _ = writeln!(text, "  {variant}: {example}");
    }
}

/// Prints examples of an enum. A variant without an example does not compile.
macro_rules! examples {
    ($text:ident, $type:ident: $(
        $variant:ident $(($($value:expr),*))? $({ $($field:tt)* })?
    ),* $(,)?) => {{
        #[allow(unreachable_patterns, reason = "some variants have several examples")]
        let _all = |value: &$type| match value { $($type::$variant { .. } => ()),* };
        section(&mut $text, stringify!($type), &[
            $((stringify!($variant), $type::$variant $(($($value),*))? $({ $($field)* })?)),*
        ]);
    }};
}

fn full_disk() -> io::Error {
    io::Error::from(io::ErrorKind::StorageFull)
}

fn path(text: &str) -> PathBuf {
    text.into()
}

fn types() -> SelectionFault {
    SelectionFault::Types { condition: "type=sand,wall".into(), known: kinds() }
}

fn values() -> ValueCounts {
    let values = vec![(Value::Number(0.0), 60), (Value::Text("wall".into()), 40)];
    ValueCounts { name: "Type".into(), values }
}

fn kinds() -> Vec<String> {
    ["sand", "wall"].map(str::to_owned).to_vec()
}

fn names() -> Vec<String> {
    ["velocity", "density"].map(str::to_owned).to_vec()
}

#[test]
fn every_message_matches_the_committed_list() {
    let listed = format!("{}{}{}", requests(), files(), frames());
    let file = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/messages.txt");
    if std::env::var_os("MENISCUS_UPDATE").is_some() {
        std::fs::write(&file, &listed).unwrap();
    }
    let committed = std::fs::read_to_string(&file).unwrap_or_default();
    for (number, (now, before)) in listed.lines().zip(committed.lines()).enumerate() {
        assert_eq!(now, before, "line {} of {}", number + 1, file.display());
    }
    assert_eq!(listed.lines().count(), committed.lines().count(), "{}", file.display());
}

fn wide() -> UnreadPart {
    UnreadPart::WideArray { name: "spectrum".into(), numbers: 100 }
}

fn primitives(kind: &str, count: u64, points: u64) -> Primitives {
    Primitives { kinds: vec![(kind.into(), count)], points }
}

fn requests() -> String {
    let mut text = "Every error and warning of the library, with example values.\n".to_owned();
    examples!(text, Error:
        Request("no input file; name one".into()),
        SettingConflict(SettingConflict {
            setting: Setting::named("smooth"),
            with: Conflict::Packing,
        }),
        SameFile { path: path("a.ply"), other: path("a.ply") },
        SameFile { path: path("a.ply"), other: path("link.ply") },
        Cancelled,
        Unit(UnitError::Isovalue(1.5)),
        Domain(DomainError::Thin { axis: 'x' }),
        Periodic(PeriodicError::Open),
        Read(ReadError::new("frame_1.vtk", ReadFault::Empty)),
        Selection(types()),
        Vulkan(VulkanError::NoDevice),
        Write(WriteError::new("mesh.ply".as_ref(), full_disk())),
        Frame { path: Some(path("frame_1.vtk")), fault: FrameError::NoSpacing },
        Simulation(SimulationError::Step),
        WholeMesh(WholeMeshError::TooManyVertices(1 << 32)),
        Parts(PartsError::NoPlan(path("mesh.ply.meniscus-parts/plan.json"))),
        Mesh { path: path("mesh.ply"), fault: CompareError::NoSurface(Side::Mesh) },
        Solid { path: path("ship.obj"), fault: SolidFault::Open { edges: 3 } },
        Picture { path: Some(path("mesh.ply")), fault: PictureError::Size(0, 99) },
        NoAttribute {
            path: Some(path("frame_1.vtk")),
            name: "spectrum".into(),
            known: names(),
            left_out: Some(wide().to_string()),
        },
        NoAttribute { path: None, name: "heat".into(), known: Vec::new(), left_out: None },
        Sizes {
            path: Some(path("frame_1.vtk")),
            fault: SizeFault::NoAttribute { name: "size".into(), known: names() },
        },
        LittleMemory { least: 16 << 20, simplifying: None },
        LittleMemory { least: 72 << 20, simplifying: Some(2) },
        Threads("Resource temporarily unavailable".into()),
        NoSpacing {
            path: Some(path("frame_1.vtk")),
            particles: 7,
            why: NoEstimate::TooFew,
            suggested: Some(0.05),
        },
    );
    examples!(text, SizeFault:
        NoAttribute { name: "size".into(), known: names() },
        Components { name: "velocity".into(), components: 3 },
        NoDensity { name: "mass".into(), known: vec!["velocity".into(), "mass".into()] },
        NoSize { name: "radius".into() },
    );
    examples!(text, NoEstimate:
        TooFew, NotFinite, TooLarge, Coincident { places: 3 }, SinglePrecision { step: 0.03 },
    );
    examples!(text, SolidFault:
        Mesh(CompareError::NoSurface(Side::Mesh)), Open { edges: 3 }, Inconsistent { edges: 12 },
    );
    conflicts(&mut text);
    examples!(text, UnitError:
        Isovalue(1.5), Sigma(-1.0), MeanCount(0.0), Smooth(9.0), SheetStretch(0.5),
        SolidOffset(5.0), Tolerance(0.0), Volume(f64::NAN), NotFinite { name: "origin", value: f64::INFINITY },
        Length { name: "spacing", value: -0.05 },
    );
    examples!(text, DomainError: Corners, Thin { axis: 'x' }, TooFar);
    examples!(text, PeriodicError:
        Corners, Open, Walled { axis: 'y' },
        Narrow { axis: 'z', width: 1.0, reach: 0.55 }, TooFar,
    );
    examples!(text, VulkanError:
        NoLoader("libvulkan.so.1: cannot open shared object file".into()),
        SmallStack { limit: 16 << 10, least: 256 << 10 },
        NoValidation, NoDevice,
        NotFound { wanted: "radeon".into(), known: "[0] llvmpipe".into() },
        Unsuitable { device: "old GPU".into(), lacks: "it does not support Vulkan 1.2" },
        OutOfMemory { bytes: 1 << 30 },
        Lost,
        Call { call: "vkQueueSubmit", result: vk::Result::ERROR_UNKNOWN },
    );
    text
}

fn conflicts(text: &mut String) {
    let mesh = || path("mesh.obj");
    let both = [
        ("radius", Conflict::Setting(Setting::named("spacing"))),
        ("solid-offset", Conflict::Needs(Setting::named("solid"))),
        ("solid", Conflict::Indicator(IndicatorKind::Counting)),
        ("mu0", Conflict::Indicator(IndicatorKind::Symmetry)),
        ("sigma", Conflict::Indicator(IndicatorKind::Cloud)),
        ("iso", Conflict::Indicator(IndicatorKind::Cloud)),
        ("detail", Conflict::Indicator(IndicatorKind::Cloud)),
        ("smooth", Conflict::Indicator(IndicatorKind::Counting)),
        ("detail", Conflict::Method(KernelMethod::ZhuBridson)),
        ("format", Conflict::Packed(path("frame.mnf"))),
        ("cell", Conflict::Packed(path("frame.mnf"))),
        ("smooth", Conflict::Packing),
        ("method", Conflict::Packing),
        ("method", Conflict::SeveralSizes { attribute: "pscale".into() }),
        ("cell", Conflict::Sampled),
        ("simplify", Conflict::OnDevice),
        ("compress", Conflict::Format { path: mesh(), format: MeshFormat::Obj }),
        (
            "up",
            Conflict::Format { path: path("mesh.glb"), format: MeshFormat::Glb(GlbLayout::PLAIN) },
        ),
        ("attributes", Conflict::Format { path: mesh(), format: MeshFormat::Obj }),
    ];
    let messages = both.map(|(setting, with)| {
        let error = SettingConflict { setting: Setting::named(setting), with };
        let conflict = match error.with {
            Conflict::Setting(_) => "Setting",
            Conflict::Needs(_) => "Needs",
            Conflict::Indicator(_) => "Indicator",
            Conflict::Method(_) => "Method",
            Conflict::Packed(_) => "Packed",
            Conflict::Packing => "Packing",
            Conflict::SeveralSizes { .. } => "SeveralSizes",
            Conflict::Sampled => "Sampled",
            Conflict::OnDevice => "OnDevice",
            Conflict::Format { .. } => "Format",
        };
        (conflict, error)
    });
    section(text, "SettingConflict", &messages);
}

fn files() -> String {
    let mut text = String::new();
    examples!(text, ReadFault:
        Io(io::Error::other("No such file or directory")),
        Empty,
        Scratch(full_disk()),
        Compression("invalid checksum".into()),
        Truncated { what: "the positions".into(), needed: 120_000, have: 91_204 },
        Malformed { at: 57, what: "unknown byte order 3".into() },
        Line { line: 12, what: "\"north\" is not a number (column x)".into() },
        Changed,
        Mesh { faces: 12 },
        OnlyPrimitives(primitives("polygon", 12, 8)),
        OnlyPrimitives(primitives("volume", 1, 1)),
        OnlyPrimitives(primitives("PackedGeometry primitive", 2, 2)),
        Twice { other: path("a.bgeo") },
        Incomplete("frame 2 has no file for piece 1, but others have one; add the file".into()),
        ColourScale {
            attribute: "Cd".into(),
            scale: ColourScale::Bytes,
            other: path("b.ply"),
            of_other: ColourScale::Shares,
        },
        Selection(types()),
        Unsupported(
            "this build of meniscus cannot read HDF5; build it with the Cargo feature hdf5".into()
        ),
        UnknownExtension { known: ".bgeo, .csv" },
    );
    examples!(text, SelectionFault:
        NoAttribute { name: "heat".into(), known: names() },
        Component { name: "velocity".into(), attribute: "velocity".into(), components: 3 },
        Text { name: "Type".into(), value: "water".into() },
        Order { name: "material".into() },
        Types { condition: "type=sand,wall".into(), known: kinds() },
        None { of: 100, conditions: "Type=7".into(), values: vec![values()] },
        Unread(RereadError::Changed),
        Cancelled,
    );
    examples!(text, WriteFault:
        Io(full_disk()), Exists, ExistsInSimulation, UnknownExtension { known: ".ply, .obj" },
        Unsupported(
            ".stl stores coordinates as 32-bit floats, but some coordinates of this mesh are too \
             large for them; use .ply".into()
        ),
    );
    let families = || "oil_{} (8 frames), water_{} (8 frames)".into();
    let state = || path("mesh/f.ply.meniscus/state.json");
    examples!(text, SimulationError:
        NoFrames("sim".into()),
        NoMatch("sim/frame_{}.bgeo".into()),
        NoFiles("sim/*.bgeo".into()),
        NoFolder(path("sim")),
        Unreadable { path: path("sim"), fault: io::ErrorKind::PermissionDenied.into() },
        NoFrameSelected("sim/f_{}.bgeo".into()),
        Rate { rate: 0.0, range: crate::error::FPS },
        Timeout(-1.0),
        Steps("sim.h5part".into()),
        Joined("sim/f_{}_{piece}.npy".into()),
        Unwatched("sim/spray_{}.npy".into()),
        Range { first: 5, last: 3 },
        Step,
        Names(
            "f_1_2.csv: the digits in this name could be one decimal number (1_2 as 1.2) or two \
             integers; use the input pattern \"f_{time}.csv\" or \"f_1_{}.csv\", where {time} is a \
             decimal number".into()
        ),
        Several { from: "sim".into(), families: families(), why: WhyOne::Request },
        Several { from: "sim".into(), families: families(), why: WhyOne::Pattern },
        Several { from: "sim".into(), families: families(), why: WhyOne::Names },
        Io { path: path("mesh"), fault: full_disk() },
        State { path: state(), what: "expected value at line 1 column 1".into() },
        Busy(state()),
        OtherInputs {
            path: state(),
            recorded: "/data/run_1".into(),
            inputs: "/data/run_2".into(),
            frame: 1,
        },
        Settings { path: state(), differing: "smooth, cell".into() },
    );
    let plan = || path("m.ply.meniscus-parts/plan.json");
    examples!(text, PartsError:
        Count { asked: 5000, most: 1000 },
        NoPart { part: 8, of: 8 },
        NoFile(path("/dev/null")),
        NoPlan(plan()),
        Plan { path: plan(), what: "it was modified after it was written".into() },
        Settings { path: plan(), differing: "smooth".into() },
        Changed { input: path("frame.bgeo"), plan: plan() },
        Missing { folder: path("m.ply.meniscus-parts"), missing: vec![0, 1, 2, 7], of: 8 },
        Damaged { path: path("m.ply.meniscus-parts/part_3"), what: "its checksum is wrong".into() },
        OtherPlan(path("m.ply.meniscus-parts/part_3")),
        Io { path: plan(), fault: full_disk() },
    );
    examples!(text, CompareError:
        NoSurface(Side::Reference), NotFinite { side: Side::Mesh, vertex: 12 },
    );
    examples!(text, PictureError:
        Size(0, 99),
        View("the positions of the camera and of its target must be finite and different"),
        Map { name: "rainbow".into(), known: "viridis, turbo".into() },
        NoAttribute { name: "heat".into(), known: "velocity".into() },
        Reference(CompareError::NoSurface(Side::Reference)),
        Memory { needed: 1 << 30, allowed: 1 << 20 },
        Io(io::ErrorKind::UnexpectedEof.into()),
    );
    text
}

fn frames() -> String {
    let mut text = String::new();
    let census = Census { not_finite: 2, too_far: 1, outside: 5, ..Census::default() };
    let iso = Isovalue::new(0.4).unwrap();
    let mean = NoMeanCount(UnitError::MeanCount(70_000.0));
    let small = TooSmall { components: 3, drops: 1 };
    let fine = TooFine::Finest { cell_size: 0.001, spacing: 0.05 };
    let over = OverBudget { cell_size: 0.01, budget: 16 << 20, fitting_cell_size: 0.02 };
    let far = BinError::TooFar { index: 7, position: [1e12, 0.0, 0.0], cell_size: 0.1 };
    examples!(text, FrameError:
        NoParticles(census), NoParticles(Census::default()), Bin(far), Unread(RereadError::Changed),
        Kind(KindFault::Scale { name: "Cd".into(), greatest: 200.0 }),
        OverBudget(over), MeanCount(mean), TooFine(fine), NoSurface { iso },
        NoDistanceSurface { at_solids: false }, NoDistanceSurface { at_solids: true },
        OtherIndicator, OtherCells { own: [0.06, 0.12], calibrated: [0.05, 0.1] },
        FewImages { needed: 40, there: 22 }, NoSpacing,
        Kernels(TooManyCells(20.0)), NoKernelSurface,
        NoRoom { folder: path("/tmp"), needed: 1 << 30, free: 1 << 20 },
        WideAttributes { components: 300, needed: 1 << 30, budget: 1 << 20 },
        NothingLeft(small), TooManyVertices, NoSpace { vertices: 100, triangles: 200 },
        Vulkan(VulkanError::Lost), Cancelled,
        Scratch { folder: path("/tmp"), fault: full_disk() },
    );
    examples!(text, BinError:
        NotFinite { index: 7, position: [0.0, f64::NAN, 0.0] },
        TooManyBins { limit: 1 << 26 },
        OutsideBox { index: 7, position: [2.0, 0.0, 0.0], axis: 'x', farthest: 0.05 },
        TooFar { index: 7, position: [1e12, 0.0, 0.0], cell_size: 0.1 },
    );
    examples!(text, KindFault:
        TooWide { name: "id".into(), value: 1 << 40, limits: [0, u32::MAX.into()] },
        Scale { name: "Cd".into(), greatest: 200.0 },
        NoByte { name: "Cd".into(), value: 300.0 },
        Fraction { name: "temp".into(), value: 0.5 },
        Type {
            name: "stress".into(),
            own: "3 floating-point numbers".into(),
            shared: "one floating-point number".into(),
        },
    );
    examples!(text, TooFine:
        Steps { cell_size: 0.01, plateau: 12.0, step_cells: 0.2, remedy: Remedy::Cells(0.1) },
        Steps {
            cell_size: 0.01, plateau: 12.0, step_cells: 0.2, remedy: Remedy::Origin([0.5; 3]),
        },
        Finest { cell_size: 0.001, spacing: 0.05 },
        Symmetry { cell_size: 0.02, spacing: 0.05 },
    );
    warnings(&mut text);
    text
}

fn warnings(all: &mut String) {
    let mut text = String::new();
    let unused = CoincidentParticles { particles: 90, most: 91, at: [0.0; 3], alone: true };
    let some = CoincidentParticles { particles: 20, most: 2, at: [0.5; 3], alone: false };
    let crossed = |moved| BeyondWall { axis: 'x', wall: 1.0, reach: 1.1, moved };
    let format = MeshFormat::Stl;
    let heat = || "heat".to_owned();
    let block = UnreadPart::Block { name: "walls".into(), holds: "a grid".into() };
    let shortfall = Shortfall { share: 0.3, particles: 1000, spacing: 0.05 };
    let (clouds, calibration_frame) = (true, None);
    examples!(text, Warning:
        Spacing(SpacingWarning::Random { used: 0.05 }),
        Crowded { times: 8.5, spacing: 0.1 },
        CoarseCells { cell_size: 0.3, spacing: 0.1 },
        Coincident { found: unused, of: 1000 },
        Coincident { found: some, of: 1000 },
        MissingValues { attribute: heat(), without: 3, of: 1000 },
        MissingValues { attribute: heat(), without: 1000, of: 1000 },
        MissingAttribute { attribute: "velocity".into(), calibration_frame: Some(1) },
        MissingAttribute { attribute: heat(), calibration_frame: None },
        Alpha { attribute: "Cd".into(), own: 4, shared: 3 },
        Alpha { attribute: "Cd".into(), own: 3, shared: 4 },
        DeviceFallback(format!("{}; continuing on the CPU", VulkanError::Lost)),
        OnCorners { mean: 0.02, origin: [0.5; 3] },
        Bubbles { iso: 0.6, lowest: 0.55 },
        BeyondWall(crossed(Some(1.1))),
        BeyondWall(crossed(None)),
        BeforeWall(GapAtWall { axis: 'y', wall: -0.05, end: 0.002 }),
        Lost { lost: 12, of: 1000, smoothed: true },
        Shortfall { shortfall, clouds: false, calibration_frame: Some(1) },
        Merged { vertices: 2, format },
        Renamed { attribute: heat(), name: "heat_2".into(), format: MeshFormat::Vtk },
        NotStored {
            attribute: "stress".into(),
            components: 9,
            format: MeshFormat::Glb(GlbLayout::PLAIN),
        },
        Coarse { format },
        InvertedSolid(path("ship.obj")),
        ThinSolid { path: path("plate.obj"), thickness: 0.01, cell_size: 0.025 },
        LeftOut(block),
        NoneSelected(SelectionFault::None {
            of: 100,
            conditions: "Type=7".into(),
            values: vec![values()],
        }),
        Empty { why: EmptyReason::Field, clouds, calibration_frame },
        Empty { why: EmptyReason::Distances { at_solids: false }, clouds, calibration_frame },
        Empty { why: EmptyReason::Distances { at_solids: true }, clouds, calibration_frame },
        Empty {
            why: EmptyReason::TooSmall(TooSmall { components: 3, drops: 1 }),
            clouds,
            calibration_frame,
        },
    );
    let known = AttributeInfo { name: heat(), components: 1, kind: AttributeKind::Number };
    let mut parts = String::new();
    examples!(parts, UnreadPart:
        Attribute(known),
        Block { name: "walls".into(), holds: "a grid".into() },
        Names(vec!["fluid".into(), "boundary".into()]),
        Primitives(primitives("polygon", 12, 8)),
        Times { column: "time".into(), count: 3, first: "0".into(), last: "0.5".into() },
        RepeatedStep,
        WideArray { name: "spectrum".into(), numbers: 100 },
        OtherShape { name: "vel".into(), shape: vec![95, 3], particles: 100, frames: None },
        OtherShape { name: "vel".into(), shape: vec![4, 95, 3], particles: 100, frames: Some(4) },
        CellData("density".into()),
        Coordinates { names: ["x", "y", "z"].map(String::from), position: "pos".into() },
    );
    // The text of an `UnreadPart` is a fragment of a sentence: see [`Warning::LeftOut`].
    for line in parts.lines() {
        match line.split_once(": ") {
            Some((variant, part)) => text += &format!("{variant}: meniscus left out {part}\n"),
            None => text += &format!("{line}\n"),
        }
    }
    let contradicted = |given, mistake, spray| SpacingWarning::Contradicted {
        given,
        source: SpacingSource::Given,
        found: 0.05,
        mistake,
        spray,
    };
    examples!(text, SpacingWarning:
        TwoResolutions { spacings: [0.05, 0.1], used: 0.05 },
        Contradicted {
            given: 0.025,
            source: SpacingSource::Given,
            found: 0.05,
            mistake: Some(SpacingMistake::Radius),
            spray: false,
        },
        Thin { used: 0.05, counted: Some(0.1), nearest: 0.04 },
        Thin { used: 0.05, counted: None, nearest: 0.04 },
        Random { used: 0.05 },
        MoreSizes { attribute: "pscale".into(), sizes: [0.05, 0.2], used: 0.1 },
        SizesContradicted {
            attribute: "h".into(),
            sizes: [0.1, 0.4],
            found: 0.05,
            spray: false,
        },
        SizesContradicted { attribute: "h".into(), sizes: [0.1, 0.4], found: 2.0, spray: true },
        Mixed(Mixture {
            attribute: "Type".into(),
            boundary: (Value::Number(1.0), 500),
            fluid: (Value::Number(0.0), 1000),
        }),
        Sizes { attribute: "radius".into(), invalid: 3, usual: 0.1, larger: 0, coarsest: 3.2 },
        Sizes { attribute: "radius".into(), invalid: 3, usual: 0.1, larger: 2, coarsest: 3.2 },
        SinglePrecision { step: 0.03, spacing: 0.05 },
    );
    section(
        &mut text,
        "SpacingMistake",
        &[
            ("Double", contradicted(0.1, Some(SpacingMistake::Double), false)),
            ("Unit", contradicted(50.0, Some(SpacingMistake::Unit(1000.0)), false)),
            ("Unit", contradicted(0.0005, Some(SpacingMistake::Unit(0.01)), false)),
            ("none", contradicted(0.035, None, true)),
        ],
    );
    all.push_str(&text);
}
