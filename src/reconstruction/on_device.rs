//! Requests for particles that are on a device already, from the settings that all requests have.

use crate::error::{Conflict, Error, Setting, Unfit};
use crate::frame::Method;
use crate::frame::resident::DeviceRequest;
use crate::grid::units::positive_length;
use crate::settings::Tank;

use super::CellSize;
use super::builder::Reconstruction;
use super::checked::refuse_named;

/// Settings that need a host, or a mesh that is simplified or written.
const OF_HOST: [&str; 16] = [
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
    /// The request for particles that are on a device, by the settings of this one, for a
    /// [`Pipeline`](crate::devices::Pipeline). Nobody looks at such particles before, so their
    /// spacing or the cells' size has to be given, and the grid is that of the origin.
    ///
    /// # Errors
    /// [`Error::Unit`], [`Error::Domain`], [`Error::Unfit`] for settings that have no meaning
    /// there, [`Error::Request`] where neither spacing nor cell size is given, and [`Error::Frame`]
    /// for cells that are too fine for the spacing.
    pub fn on_device(&self) -> Result<DeviceRequest, Error> {
        let settings = self.settings.without_default_method();
        refuse_named(&settings, &OF_HOST, || Conflict::OnDevice)?;
        if settings.domain == Some(Tank::Auto) {
            return Err(
                Unfit { setting: Setting::named("domain"), with: Conflict::OnDevice }.into()
            );
        }
        let checked = self.checked()?;
        checked.refuse_of_indicator()?;
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
        // Kernels are refused above.
        let Method::Indicator { kind, mean } = request.method else {
            unreachable!("a method was refused")
        };
        let spacing = request.spacing;
        surfacing
            .refuse_too_fine(kind, mean, spacing, &grid)
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
