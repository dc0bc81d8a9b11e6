//! Checks that the packages that are published together have the same version, repository and
//! minimum Rust version in their manifests.

use std::fs;
use std::path::Path;

/// Manifests that contain the version, under the key `version`.
const VERSIONED: [&str; 6] = [
    "Cargo.toml",
    "src/bindings/c/Cargo.toml",
    "src/bindings/c/header/Cargo.toml",
    "src/bindings/python/Cargo.toml",
    "src/bindings/blender/extension/blender_manifest.toml",
    "tools/package/recipe.yaml",
];

fn read(name: &str) -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(name)).expect(name)
}

/// The first value of a key, in TOML or YAML.
fn field<'a>(text: &'a str, key: &str) -> Option<&'a str> {
    let value = |line: &'a str| {
        let rest = line.trim().strip_prefix(key)?.trim_start();
        Some(rest.strip_prefix(['=', ':'])?.trim().trim_matches('"'))
    };
    text.lines().find_map(value)
}

#[test]
fn published_packages_share_one_version_that_is_in_the_changelog() {
    let version = env!("CARGO_PKG_VERSION");
    for name in VERSIONED {
        assert_eq!(field(&read(name), "version"), Some(version), "{name}");
    }
    let changelog = read("src/changelog.md");
    assert!(changelog.lines().any(|line| line == format!("# {version}")));
    assert!(changelog.contains(&format!("version = {{{version}}}")));
}

#[test]
fn manifests_agree_on_the_minimum_rust_version() {
    let oldest = env!("CARGO_PKG_RUST_VERSION");
    for name in ["src/bindings/c/Cargo.toml", "src/bindings/python/Cargo.toml"] {
        assert_eq!(field(&read(name), "rust-version"), Some(oldest), "{name}");
    }
    assert!(read("README.md").contains(oldest), "README.md does not mention Rust {oldest}");
}

#[test]
fn github_links_in_published_files_lead_to_this_repository() {
    let address = env!("CARGO_PKG_REPOSITORY");
    let named = [
        "src/changelog.md",
        "src/links.md",
        "src/bindings/python/pyproject.toml",
        "src/bindings/blender/extension/blender_manifest.toml",
        "tools/package/recipe.yaml",
        "tools/package/Dockerfile",
    ];
    for name in named {
        let text = read(name);
        let others = text
            .match_indices("https://github.com/")
            .filter(|(at, _)| !text[*at..].starts_with(address));
        assert!(
            text.contains(address) && others.count() == 0,
            "{name} must link to {address} and to no other GitHub repository"
        );
    }
}
