//! Fuzzes the program's arguments: they are parsed into a request, which is not run.

use meniscus::program::{error_message, parsed};

use super::Target;

pub fn targets() -> Vec<Target> {
    vec![Target { name: "arguments", runs: 1000, run, seeds, words: WORDS }]
}

const WORDS: &[&str] = &[
    "reconstruct",
    "pack",
    "info",
    "check",
    "compare",
    "render",
    "\n",
    "-o\n",
    "--spacing\n",
    "--cell\n",
    "--smooth\n",
    "--sigma\n",
    "--iso\n",
    "--domain\n",
    "--periodic\n",
    "-,-,0,",
    "--origin\n",
    "--indicator\n",
    "symmetry",
    "counting",
    "cloud",
    "--method\n",
    "mueller",
    "zhu-bridson",
    "yu-turk",
    "--memory\n",
    "64MiB",
    "18446744073709551616",
    "--threads\n",
    "--frames\n",
    "1..5",
    "--parts\n",
    "--part\n",
    "--merge\n",
    "--plan\n",
    "--simplify\n",
    "--smallest-drop\n",
    "--attributes\n",
    "--watch",
    "=1e-9",
    "--fps\n",
    "--mu0\n",
    "--backend\n",
    "auto",
    "--device\n",
    "nan",
    "-inf",
    "1e308",
    "-0",
];

/// Parses arguments, one per line.
fn run(data: &[u8]) {
    let Ok(text) = str::from_utf8(data) else { return };
    let arguments = ["meniscus"].into_iter().chain(text.split('\n'));
    match parsed(arguments.map(Into::into)) {
        Ok(Some((settings, request))) => {
            // The library checks the range of numbers only when the request runs.
            assert_eq!(format!("{:?}", request.settings()), format!("{settings:?}"));
            let opened = request.open("there/is/none.xyz");
            assert!(opened.is_err_and(|error| !error_message(&error).is_empty()));
        }
        Ok(None) => {}
        Err(message) => assert!(!message.is_empty()),
    }
}

fn seeds() -> Vec<Vec<u8>> {
    let lines = [
        "reconstruct\nin.bgeo\n-o\nout.ply\n--spacing\n0.05\n--domain\n0,0,0,1,1,1\n--normals\n--simplify\n0.5",
        "reconstruct\nin_{}.bgeo\n-o\nout/\n--frames\n1..5\n--resume\n--memory\n2GiB\n--threads\n2\n--watch=3",
        "reconstruct\na.vtu\n-o\na.glb\n--compress\n--periodic\n0,-,0,1,-,1\n--iso\n0.4\n--indicator\ncounting\n--mu0\n8",
        "pack\na.xyz\n-o\na.mnf\n--cell\n0.25",
        "render\na.ply\n-o\na.png",
        "compare\na.ply\nb.ply\n--json",
    ];
    lines.map(|text| text.as_bytes().to_vec()).to_vec()
}
