//! Meshes of the bundled dam break in every format that other programs open, with the files that list them.

use std::error::Error;
use std::path::Path;
use std::process::Command;

use meniscus::io::CoordinateWidth;
use meniscus::io::UpAxis;
use meniscus::io::output::{MeshFormat, MeshOutput, read_mesh};
use meniscus::io::series::{Series, SeriesFacts, SeriesFrame};
use meniscus::io::whole::Replace;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args().nth(1).ok_or("usage: interop FOLDER")?;
    let folder = Path::new(&folder);
    std::fs::create_dir_all(folder)?;
    let program = std::env::current_exe()?.with_file_name("../meniscus");
    let facts = SeriesFacts { frames_per_second: 25.0, up: UpAxis::Y };
    for format in [MeshFormat::Vtp, MeshFormat::Vtk, MeshFormat::Ply, MeshFormat::Obj, MeshFormat::Usdc] {
        let mut series = Series::new(format, &folder.join("dam"), facts);
        for frame in [1, 10, 20] {
            let particles = format!("tests/data/dambreak_small/ParticleData_Fluid_{frame}.bgeo");
            let mesh = folder.join(format!("dam_{frame}.ply"));
            if format == MeshFormat::Vtp {
                let options = ["--normals", "--quiet", "--overwrite", "--attributes", "velocity,density"];
                let mut run = Command::new(&program);
                run.arg("reconstruct").arg(&particles).arg("-o").arg(&mesh).args(options);
                if !run.status()?.success() {
                    return Err(format!("{particles} was not reconstructed").into());
                }
            }
            let mesh = read_mesh(&mesh)?;
            let path = folder.join(format!("dam_{frame}{format}"));
            MeshOutput::prepare(&path, Replace::Allow)?.write(&mesh, CoordinateWidth::F32)?;
            series.tell(SeriesFrame::new(path, f64::from(frame) / 25.0, &mesh, None))?;
        }
    }
    Ok(())
}
