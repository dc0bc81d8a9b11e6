//! Requests for particles that are already on a device.

use crate::error::{Conflict, Error, Setting, SettingConflict};
use crate::frame::Method;
use crate::frame::resident::DeviceRequest;
use crate::grid::units::positive_length;
use crate::settings::Tank;

use super::CellSize;
use super::builder::Reconstruction;
use super::checked::refuse_named;

/// Settings that cannot be combined with particles on a device, because they are implemented only
/// on the host, or apply only when the mesh is simplified or written.
const HOST_SETTINGS: [&str; 16] = [
    "size",
    "method",
    "periodic",
    "periodic_mesh",
    "solid",
    "solid_offset",
    "normals",
    "attributes",
    "simplify",
    "smallest_component",
    "smallest_drop",
    "compress",
    "up",
    "particles_up",
    "format",
    "where",
];

impl Reconstruction {
    /// Converts the request for a [`Pipeline`](crate::devices::Pipeline), which meshes particles
    /// that are already on a device. The host does not read such particles, so the request must
    /// have a spacing or a cell size, and the grid is not moved to suit a lattice of particles.
    ///
    /// # Errors
    /// [`Error::Unit`], [`Error::Domain`], [`Error::SettingConflict`] for settings that do not
    /// apply on a device, [`Error::Request`] if the request has neither a spacing nor a cell size,
    /// and [`Error::Frame`] for cells that are too fine for the spacing.
    pub fn on_device(&self) -> Result<DeviceRequest, Error> {
        let settings = self.settings.without_default_method();
        refuse_named(&settings, &HOST_SETTINGS, || Conflict::OnDevice)?;
        if settings.domain == Some(Tank::Auto) {
            return Err(SettingConflict {
                setting: Setting::named("domain"),
                with: Conflict::OnDevice,
            }
            .into());
        }
        let checked = self.checked()?;
        checked.check_indicator()?;
        let (request, surfacing) = (&checked.sampling, checked.surfacing.clone());
        let size = match (request.cell_size(), request.spacing) {
            (CellSize::Length(size), _) => size,
            (CellSize::Spacings(ratio), Some(spacing)) => {
                positive_length("cell-size", ratio * spacing)?
            }
            (CellSize::Spacings(_), None) => {
                let what = "spacing must be given for particles on a device";
                return Err(Error::Request(what.into()));
            }
        };
        let grid = request.grid(size)?;
        let domain = request.domain(&grid)?;
        // `refuse_named` has rejected kernel methods above.
        let Method::Indicator { kind, mean } = request.method else {
            unreachable!("kernel methods are rejected")
        };
        let spacing = request.spacing;
        surfacing
            .check_cell_size(kind, mean, spacing, &grid)
            .map_err(crate::frame::FrameError::from)?;
        let (invalid, calibration) = (request.invalid, checked.calibration);
        Ok(DeviceRequest {
            grid,
            domain,
            indicator: kind,
            mean,
            invalid,
            spacing,
            surfacing,
            calibration,
        })
    }
}
