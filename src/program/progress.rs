//! Shows the progress of a simulation: as bars on a terminal, or as a line for each frame.

use std::io::{self, IsTerminal, Write};
use std::time::Duration;

use clap::ValueEnum;
use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle, TermLike};

use super::notes::Notes;

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ProgressMode {
    /// Bars on a terminal, else a line for each frame.
    Auto,
    /// Bars, even if the output is not a terminal.
    Always,
    /// A line for each frame.
    Never,
}

/// Progress bars, if enabled: one for all frames together, and one for each lane. A lane converts
/// one frame at a time.
pub struct ProgressBars {
    bars: Option<(ProgressBar, Vec<ProgressBar>)>,
}

impl ProgressBars {
    /// Starts the progress bars, and returns notes that are printed above the bars. `bytes` is the
    /// total size of the inputs. The remaining time is estimated from bytes, not from the number of
    /// frames, because frames differ in size.
    pub fn start(mode: ProgressMode, bytes: u64, lanes: usize, notes: Notes) -> (Self, Notes) {
        let wanted = match mode {
            ProgressMode::Auto => io::stderr().is_terminal(),
            ProgressMode::Always => true,
            ProgressMode::Never => false,
        };
        if !wanted || notes.is_quiet() {
            return (Self { bars: None }, notes);
        }
        let all = match mode {
            ProgressMode::Always if !io::stderr().is_terminal() => MultiProgress::with_draw_target(
                ProgressDrawTarget::term_like_with_hz(Box::new(TerminalOutput), 2),
            ),
            _ => MultiProgress::new(),
        };
        let style =
            |template: &str| ProgressStyle::with_template(template).expect("the template is valid");
        let frames = all.add(ProgressBar::new(bytes));
        frames.set_style(style("[{bar:30}] {msg}, {elapsed} elapsed, about {eta} left"));
        frames.enable_steady_tick(Duration::from_millis(500));
        let lane = || {
            let bar = all.add(ProgressBar::new_spinner());
            bar.set_style(style("  {spinner} {msg}"));
            bar.enable_steady_tick(Duration::from_millis(200));
            bar
        };
        let lanes = (0..lanes).map(|_| lane()).collect();
        (Self { bars: Some((frames, lanes)) }, notes.above(all))
    }

    pub fn has_bars(&self) -> bool {
        self.bars.is_some()
    }

    /// Shows the current stage of a lane.
    pub fn stage(&self, lane: usize, what: impl FnOnce() -> String) {
        if let Some(bar) = self.bars.as_ref().and_then(|(_, lanes)| lanes.get(lane)) {
            bar.set_message(what());
        }
    }

    /// Shows the number of finished frames, and advances the bar by the `bytes` of the frame that
    /// has just finished or failed.
    pub fn advance(&self, done: usize, frames: usize, failed: usize, bytes: u64) {
        let Some((bar, _)) = &self.bars else { return };
        let failed = if failed > 0 { format!(", {failed} failed") } else { String::new() };
        bar.set_message(format!("{done} of {frames} frames{failed}"));
        bar.inc(bytes);
    }

    /// Extends the bar for all frames by the `bytes` of a new frame.
    pub fn lengthen(&self, bytes: u64) {
        if let Some((bar, _)) = &self.bars {
            bar.inc_length(bytes);
        }
    }

    pub fn finish(&self) {
        if let Some((bar, lanes)) = &self.bars {
            lanes.iter().for_each(ProgressBar::finish_and_clear);
            bar.finish_and_clear();
        }
    }
}

/// Draws bars on standard error even if it is not a terminal, for callers that forward standard
/// error to a terminal. Ignores write errors.
#[derive(Debug)]
struct TerminalOutput;

impl TerminalOutput {
    fn put(text: &str) -> io::Result<()> {
        let _ = io::stderr().write_all(text.as_bytes());
        Ok(())
    }

    fn escape(n: usize, letter: char) -> io::Result<()> {
        if n > 0 { Self::put(&format!("\x1b[{n}{letter}")) } else { Ok(()) }
    }
}

impl TermLike for TerminalOutput {
    fn width(&self) -> u16 {
        80
    }

    fn move_cursor_up(&self, n: usize) -> io::Result<()> {
        Self::escape(n, 'A')
    }

    fn move_cursor_down(&self, n: usize) -> io::Result<()> {
        Self::escape(n, 'B')
    }

    fn move_cursor_right(&self, n: usize) -> io::Result<()> {
        Self::escape(n, 'C')
    }

    fn move_cursor_left(&self, n: usize) -> io::Result<()> {
        Self::escape(n, 'D')
    }

    fn write_line(&self, line: &str) -> io::Result<()> {
        Self::put(&format!("{line}\n"))
    }

    fn write_str(&self, text: &str) -> io::Result<()> {
        Self::put(text)
    }

    fn clear_line(&self) -> io::Result<()> {
        Self::put("\r\x1b[2K")
    }

    fn flush(&self) -> io::Result<()> {
        Ok(())
    }
}
