//! Images with 8 bits per channel, and their labels, contact sheets and files.

use std::convert::Infallible;
use std::io::{self, BufRead, Seek, Write};

use embedded_graphics::Pixel;
use embedded_graphics::draw_target::DrawTarget;
use embedded_graphics::geometry::{OriginDimensions, Point, Size};
use embedded_graphics::mono_font::MonoTextStyle;
use embedded_graphics::mono_font::ascii::{FONT_6X10, FONT_10X20};
use embedded_graphics::pixelcolor::{Rgb888, RgbColor};
use embedded_graphics::prelude::Drawable;
use embedded_graphics::text::{Alignment, Baseline, Text, TextStyleBuilder};

/// Images with more rows than this have labels in a larger font.
const LARGE_FONT_ROWS: usize = 540;
const TEXT_COLOUR: Rgb888 = Rgb888::new(28, 32, 36);
/// Gap between images of a sheet, in pixels.
const GAP: usize = 4;
const BACKGROUND: u8 = 255;
/// The keyword of the text that names the source of a picture.
const SOURCE: &str = "meniscus";

/// Rows of pixels from the top: red, green and blue, 8 bits each, in sRGB.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Image {
    width: usize,
    height: usize,
    rgb: Vec<u8>,
}

impl Image {
    pub(super) fn new(width: usize, height: usize, rgb: Vec<u8>) -> Self {
        assert_eq!(rgb.len(), 3 * width * height, "three bytes per pixel");
        Self { width, height, rgb }
    }

    /// The width in pixels.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// The height in pixels.
    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// The bytes of all pixels: rows from the top, three bytes per pixel.
    #[must_use]
    pub fn rgb(&self) -> &[u8] {
        &self.rgb
    }

    /// Adds a line of text in the upper left corner.
    #[must_use]
    pub fn labelled(mut self, text: &str) -> Self {
        self.text(text, [10, 8], Alignment::Left);
        self
    }

    /// Writes text. Depending on `alignment`, `[x, y]` is the upper left corner, the middle of the
    /// upper edge, or the upper right corner of the text.
    pub(super) fn text(&mut self, text: &str, [x, y]: [i32; 2], alignment: Alignment) {
        let font = if self.height > LARGE_FONT_ROWS { &FONT_10X20 } else { &FONT_6X10 };
        let layout = TextStyleBuilder::new().alignment(alignment).baseline(Baseline::Top).build();
        let text = Text::with_text_style(
            text,
            Point::new(x, y),
            MonoTextStyle::new(font, TEXT_COLOUR),
            layout,
        );
        let Ok(_) = text.draw(self);
    }

    /// The height of a line of text.
    pub(super) fn line(&self) -> i32 {
        if self.height > LARGE_FONT_ROWS { 20 } else { 10 }
    }

    pub(super) fn set(&mut self, x: usize, y: usize, colour: [u8; 3]) {
        if x < self.width && y < self.height {
            self.rgb[3 * (y * self.width + x)..][..3].copy_from_slice(&colour);
        }
    }

    /// Joins images of the same size into a sheet with `columns` images per row; `None` if there
    /// are no images.
    ///
    /// # Panics
    /// If the sizes of the images differ.
    #[must_use]
    pub fn sheet(images: &[Self], columns: usize) -> Option<Self> {
        let Self { width, height, .. } = *images.first()?;
        let columns = columns.clamp(1, images.len());
        let rows = images.len().div_ceil(columns);
        let (full_width, full_height) =
            (columns * (width + GAP) - GAP, rows * (height + GAP) - GAP);
        let mut rgb = vec![BACKGROUND; 3 * full_width * full_height];
        for (n, image) in images.iter().enumerate() {
            assert_eq!((image.width, image.height), (width, height), "images of equal size");
            let (left, top) = (n % columns * (width + GAP), n / columns * (height + GAP));
            for (y, row) in image.rgb.chunks(3 * width).enumerate() {
                rgb[3 * ((top + y) * full_width + left)..][..3 * width].copy_from_slice(row);
            }
        }
        Some(Self { width: full_width, height: full_height, rgb })
    }

    /// Writes a `.png` file.
    ///
    /// # Errors
    /// If `out` cannot be written.
    pub fn write_png(&self, out: &mut dyn Write) -> io::Result<()> {
        self.write_png_of(out, None)
    }

    /// Writes a `.png` file with a text that names its source, which [`source_of_png`] reads.
    pub(crate) fn write_png_of(&self, out: &mut dyn Write, source: Option<&str>) -> io::Result<()> {
        let mut encoder = self.encoder(out);
        if let Some(source) = source {
            encoder.add_itxt_chunk(SOURCE.to_owned(), source.to_owned())?;
        }
        encoder.set_compression(png::Compression::Fast);
        encoder.write_header()?.write_image_data(&self.rgb)?;
        Ok(())
    }

    fn encoder<'a>(&self, out: &'a mut dyn Write) -> png::Encoder<'static, &'a mut dyn Write> {
        let mut encoder = png::Encoder::new(out, self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
        encoder
    }
}

/// The text that names the source of a `.png` file that this library wrote; `None` for other files.
pub(crate) fn source_of_png(file: &mut (impl BufRead + Seek)) -> Option<String> {
    let reader = png::Decoder::new(file).read_info().ok()?;
    let text = reader.info().utf8_text.iter().find(|text| text.keyword == SOURCE)?;
    text.get_text().ok()
}

/// An animated `.png` file that is written image by image.
pub struct Animation<'a> {
    writer: png::Writer<&'a mut dyn Write>,
    size: [usize; 2],
}

impl<'a> Animation<'a> {
    /// Starts a file of `images` images that have the size of `first`, with `fps` images per
    /// second. The animation repeats forever.
    ///
    /// # Errors
    /// If `out` cannot be written, or if `images` is 0.
    pub fn begin(out: &'a mut dyn Write, first: &Image, images: u32, fps: f64) -> io::Result<Self> {
        let mut encoder = first.encoder(out);
        encoder.set_animated(images, 0)?;
        // The delay is in milliseconds, which is precise enough for every valid rate.
        encoder.set_frame_delay((1000.0 / fps).round().clamp(1.0, 65_535.0) as u16, 1000)?;
        Ok(Self { writer: encoder.write_header()?, size: [first.width, first.height] })
    }

    /// Adds an image.
    ///
    /// # Errors
    /// If the file cannot be written, or if it already has all announced images.
    ///
    /// # Panics
    /// If the image does not have the size of the first image.
    pub fn push(&mut self, image: &Image) -> io::Result<()> {
        assert_eq!([image.width, image.height], self.size, "images of equal size");
        Ok(self.writer.write_image_data(&image.rgb)?)
    }

    /// Ends the file.
    ///
    /// # Errors
    /// If writing fails, or if fewer images were added than announced.
    pub fn end(self) -> io::Result<()> {
        Ok(self.writer.finish()?)
    }
}

impl OriginDimensions for Image {
    fn size(&self) -> Size {
        Size::new(self.width as u32, self.height as u32)
    }
}

impl DrawTarget for Image {
    type Color = Rgb888;
    type Error = Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<Rgb888>>>(
        &mut self,
        pixels: I,
    ) -> Result<(), Infallible> {
        for Pixel(Point { x, y }, colour) in pixels {
            if let (Ok(x), Ok(y)) = (usize::try_from(x), usize::try_from(y)) {
                self.set(x, y, [colour.r(), colour.g(), colour.b()]);
            }
        }
        Ok(())
    }
}
