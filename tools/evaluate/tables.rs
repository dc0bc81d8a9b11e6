//! Markdown tables, and the formats of their numbers.

/// A Markdown table, which is printed below a line that describes the measurement.
pub struct Table {
    head: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Table {
    pub fn new(head: &[&str]) -> Self {
        Self { head: head.iter().map(|&text| text.into()).collect(), rows: Vec::new() }
    }

    pub fn row(&mut self, cells: impl IntoIterator<Item = String>) {
        self.rows.push(cells.into_iter().collect());
    }

    /// Prints the table below a line with the description `what` and the command of this run.
    pub fn print(&self, what: &str) {
        self.show(&format!("{what} (`{}`)", command()));
    }

    /// Prints the table below a line with the description `what`.
    pub fn show(&self, what: &str) {
        println!("{what}:\n\n| {} |", self.head.join(" | "));
        println!("|{}", "---|".repeat(self.head.len()));
        for row in &self.rows {
            println!("| {} |", row.join(" | "));
        }
        println!();
    }
}

/// The command that repeats this measurement.
fn command() -> String {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    format!("cargo run --release --example evaluate -- {}", arguments.join(" "))
}

pub fn mean(values: impl IntoIterator<Item = f64>) -> f64 {
    let (sum, count) =
        values.into_iter().fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    sum / count
}

/// The standard deviation of a sample.
pub fn deviation(values: &[f64]) -> f64 {
    let middle = mean(values.iter().copied());
    let squares: f64 = values.iter().map(|value| (value - middle).powi(2)).sum();
    if values.len() < 2 { 0.0 } else { (squares / (values.len() - 1) as f64).sqrt() }
}

/// The value farthest from 0.
pub fn worst(values: impl IntoIterator<Item = f64>) -> f64 {
    values
        .into_iter()
        .fold(0.0, |worst: f64, value| if value.abs() > worst.abs() { value } else { worst })
}

/// The mean of several values, followed by the value farthest from 0 in brackets.
pub fn mean_and_worst(values: &[f64]) -> String {
    format!("{} ({})", figure(mean(values.iter().copied())), figure(worst(values.iter().copied())))
}

/// Formats a number with three decimals.
pub fn figure(value: f64) -> String {
    format!("{value:.3}")
}

pub fn signed(value: f64) -> String {
    format!("{value:+.3}")
}

pub fn percent(share: f64) -> String {
    format!("{:+.2} %", share * 1e2)
}
