//! The table of all methods: error, cost and stability side by side; and the same as CSV.

use super::comparison::Row;
use super::page::{Cell, Table, method_label, percent};

/// Rows of one scenario.
pub fn of_rows(scenario: &str, rows: &[Row]) -> Table {
    let rows: Vec<&Row> = rows.iter().filter(|r| r.scenario == scenario).collect();
    let some_temporal = rows.iter().any(|r| r.temporal.is_some());
    let mut header =
        vec!["method", "coefficients", "bytes / texel", "multiply-adds / texel", "model", "mean", "median", "worst"];
    header.extend(["oracle", "total"]);
    header.extend(some_temporal.then_some("frame to frame"));
    header.push("λ");
    let line = |(i, row): (usize, &&Row)| {
        let same = |other: &Row| (other.method, other.lambda_choice) == (row.method, row.lambda_choice);
        let first = i == 0 || !same(rows[i - 1]);
        let quiet = |text: Option<String>| Cell { class: "quiet", ..Cell::new(text.unwrap_or_default()) };
        let name = if first { method_label(row.method, row.lambda_choice) } else { String::new() };
        let mut cells = vec![
            Cell { first, ..Cell::name(name) },
            Cell::new(row.coefficients.to_string()),
            Cell::new(row.cost.bytes_per_texel.to_string()),
            Cell::new(row.cost.multiply_adds_per_texel.to_string()),
            Cell::new(match row.cost.model_bytes as f64 {
                bytes if bytes < 1e5 => format!("{:.1} kB", bytes * 1e-3),
                bytes => format!("{:.2} MB", bytes * 1e-6),
            }),
            Cell { class: "strong", ..Cell::new(with_spread(row.mean, row.spread)) },
            Cell::percent(row.median),
            Cell::percent(row.worst),
            quiet(row.oracle_mean.map(percent)),
            Cell::percent(row.total_mean),
        ];
        cells.extend(
            some_temporal
                .then(|| Cell::new(row.temporal.map_or(String::new(), |t| with_spread(t, row.temporal_spread)))),
        );
        cells.push(quiet(row.lambda.map(|lambda| format!("{lambda:.1e}"))));
        cells
    };
    Table {
        title: format!("Scenario: {scenario}"),
        header: header.into_iter().map(str::to_owned).collect(),
        rows: rows.iter().enumerate().map(line).collect(),
    }
}

/// A fraction and its standard deviation, in percent.
pub fn with_spread(mean: f64, spread: Option<f64>) -> String {
    match spread {
        Some(spread) => format!("{:.1} ± {:.1} %", 100.0 * mean, 100.0 * spread),
        None => percent(mean),
    }
}

/// One line a row.
pub fn csv(rows: &[Row]) -> String {
    let mut out = String::from(
        "scenario,method,lambda_choice,lambda,coefficients,bytes_per_texel,multiply_adds_per_texel,model_bytes,points,mean,spread,median,worst,oracle_mean,total_mean,temporal,temporal_spread\n",
    );
    for r in rows {
        let number = |v: Option<f64>| v.map_or(String::new(), |v| v.to_string());
        let fields = [
            r.scenario.clone(),
            r.method.to_owned(),
            r.lambda_choice.unwrap_or("").to_owned(),
            number(r.lambda),
            r.coefficients.to_string(),
            r.cost.bytes_per_texel.to_string(),
            r.cost.multiply_adds_per_texel.to_string(),
            r.cost.model_bytes.to_string(),
            r.points.to_string(),
            r.mean.to_string(),
            number(r.spread),
            r.median.to_string(),
            r.worst.to_string(),
            number(r.oracle_mean),
            r.total_mean.to_string(),
            number(r.temporal),
            number(r.temporal_spread),
        ];
        out += &(fields.join(",") + "\n");
    }
    out
}

/// Lines of `header` and `rows`.
pub fn lines<R: AsRef<[String]>>(header: &str, rows: impl IntoIterator<Item = R>) -> String {
    let rows = rows.into_iter().map(|row| row.as_ref().join(",") + "\n");
    std::iter::once(format!("{header}\n")).chain(rows).collect()
}
