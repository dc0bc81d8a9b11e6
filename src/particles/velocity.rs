//! The names of the velocity. Every reader finds the velocity of particles by these names.

use super::AttributeInfo;

/// The names that simulators use for the velocity of particles, in order of preference.
pub const VELOCITY_NAMES: [&str; 24] = [
    "velocity",
    "v",
    "Vel",
    "vel",
    "V",
    "Velocity",
    "velocities",
    "Velocities",
    ".velocities",
    "vels",
    "particle_velocity",
    "particle_velocities",
    "particle_vel",
    "particle_v",
    "particle_qd",
    "particles_velocity",
    "particles_vel",
    "p_velocity",
    "p_vel",
    "p_v",
    "v_p",
    "vp",
    "vel_p",
    "fluid_velocity",
];

/// Names that each stand for the three columns of a velocity in the header of a table.
pub const VELOCITY_WORDS: [&str; 5] = ["v", "vel", "vels", "velocity", "velocities"];

/// OpenFOAM's name of the velocity. In lower case, it often means a displacement.
pub const OPENFOAM_VELOCITY: &str = "U";

/// The index of the velocity among the attributes: the attribute of three components whose name has
/// the lowest rank among the names of the velocity, in any case and with any unit.
#[must_use]
pub fn velocity_attribute(attributes: &[AttributeInfo]) -> Option<usize> {
    let vectors = attributes.iter().enumerate().filter(|(_, info)| info.components == 3);
    let ranked = vectors.filter_map(|(index, info)| Some((velocity_rank(&info.name)?, index)));
    ranked.min().map(|(_, index)| index)
}

/// The rank of `name` among the names of the velocity; a lower rank is preferred. `None` for the
/// name of another quantity.
///
/// The names in [`VELOCITY_NAMES`] have the lowest ranks. Next are names that differ from them in
/// case or separators, or that a unit follows, such as `VEL`, `particle velocity`,
/// `ParticleVelocity` and `velocity [m/s]`. OpenFOAM's `U` is last.
pub fn velocity_rank(name: &str) -> Option<usize> {
    let listed = |name: &str| VELOCITY_NAMES.iter().position(|known| *known == name);
    let bare = without_unit(name);
    let lower = || listed(&bare.to_ascii_lowercase().replace([' ', '-'], "_"));
    let alike = || lower().or_else(|| listed(&words_of(bare).to_ascii_lowercase()));
    listed(name)
        .or_else(|| alike().map(|rank| VELOCITY_NAMES.len() + rank))
        .or_else(|| (bare == OPENFOAM_VELOCITY).then_some(2 * VELOCITY_NAMES.len()))
}

/// The name with an underscore before each capital that follows a lowercase letter.
fn words_of(name: &str) -> String {
    let mut words = String::with_capacity(name.len() + 4);
    for letter in name.chars() {
        if letter.is_ascii_uppercase() && words.ends_with(|c: char| c.is_ascii_lowercase()) {
            words.push('_');
        }
        words.push(letter);
    }
    words
}

/// The name without a unit in brackets or parentheses at its end.
fn without_unit(name: &str) -> &str {
    let unit = name.find(['[', '(']).filter(|_| name.ends_with([']', ')']));
    unit.map_or(name, |at| &name[..at]).trim()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(attributes: &[(&str, usize)]) -> Option<usize> {
        let infos: Vec<_> =
            attributes.iter().map(|&(name, count)| AttributeInfo::new(name, count)).collect();
        velocity_attribute(&infos)
    }

    #[test]
    fn a_velocity_may_have_any_case_or_separator_and_a_unit() {
        for name in [
            "VEL",
            "VELOCITY",
            "Particle Velocity",
            "particle-velocity",
            "fluid_velocity",
            "Fluid Velocity",
            "vELOCITY",
            "ParticleVelocity",
            "fluidVelocity",
            "velocity [m/s]",
            "Velocity(m/s)",
            "U",
            "U (m/s)",
        ] {
            assert_eq!(found(&[("rho", 1), (name, 3)]), Some(1), "{name}");
            assert_eq!(found(&[(name, 1)]), None, "{name} is a number");
        }
        for name in [
            "u",
            "acceleration",
            "velocity_gradient",
            "VelocityGradient",
            "vorticity",
            "[m/s]",
            "",
            "U2",
        ] {
            assert_eq!(found(&[(name, 3)]), None, "{name}");
        }
    }

    #[test]
    fn a_usual_name_of_the_velocity_is_preferred() {
        assert_eq!(found(&[("U", 3), ("VEL", 3), ("vp", 3)]), Some(2));
        assert_eq!(found(&[("U", 3), ("VEL", 3)]), Some(1));
        assert_eq!(found(&[("VELOCITY", 3), ("V", 3)]), Some(1));
        assert_eq!(found(&[("V", 3), ("vel", 3)]), Some(1));
    }
}
