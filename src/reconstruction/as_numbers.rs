//! Serializes a calibration to JSON. For clouds, the JSON contains the plateau. For other
//! indicators, it contains the isovalue, between 0 and 1, and for counting also mu0.

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::field::calibration::Calibration;
use crate::grid::units::{Isovalue, MeanCount, UnitError};

#[derive(Serialize, Deserialize)]
struct CalibrationNumbers {
    mu0: Option<f64>,
    isovalue: Option<f64>,
    plateau: Option<u16>,
}

/// Writes a calibration.
pub fn serialize<S: Serializer>(known: &Option<Calibration>, to: S) -> Result<S::Ok, S::Error> {
    let mu0 = known.and_then(|known| known.mean()).map(MeanCount::particles);
    let isovalue = known.and_then(|known| known.iso()).map(Isovalue::value);
    let plateau = match known {
        Some(Calibration::Clouds { plateau }) => Some(*plateau),
        _ => None,
    };
    CalibrationNumbers { mu0, isovalue, plateau }.serialize(to)
}

/// Reads a calibration, and rejects values that cannot have been measured.
pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Calibration>, D::Error> {
    let CalibrationNumbers { mu0, isovalue, plateau } = CalibrationNumbers::deserialize(from)?;
    let calibration = |iso| {
        let mean = mu0.map(MeanCount::new).transpose()?;
        Ok::<_, UnitError>(Calibration::Indicator { mean, iso: Isovalue::new(iso)? })
    };
    match (plateau, isovalue) {
        (Some(0), _) => Err(D::Error::custom("the plateau is 0")),
        (Some(plateau), None) => Ok(Some(Calibration::Clouds { plateau })),
        (Some(_), Some(_)) => Err(D::Error::custom("plateau and isovalue are both set")),
        (None, isovalue) => isovalue.map(calibration).transpose().map_err(D::Error::custom),
    }
}
