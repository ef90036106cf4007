//! The HTML page: one file that needs nothing beside it.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::Row;

/// A picture with what it shows.
pub struct Image {
    pub caption: String,
    pub png: Vec<u8>,
}

/// Pictures that are read together, in rows.
pub struct Plate {
    pub title: String,
    pub note: String,
    pub rows: Vec<Vec<Image>>,
    /// Whether pixels are to be seen (lightmaps) or smoothed (renders).
    pub pixelated: bool,
}

/// A plot as SVG.
pub struct Plot {
    pub title: String,
    pub note: String,
    pub svg: String,
}

/// All that the page shows.
pub struct Page {
    pub title: String,
    /// Name and value, as "texels: 14,336".
    pub facts: Vec<(String, String)>,
    pub rows: Vec<Row>,
    pub plots: Vec<Plot>,
    pub plates: Vec<Plate>,
}

/// Names that readers know the methods by.
pub fn method_label(method: &str, lambda_choice: Option<&str>) -> String {
    match (method, lambda_choice) {
        ("belcour", Some("leave-one-out")) => "Belcour 2022, λ by leave-one-out".into(),
        ("belcour", Some("published")) => "Belcour 2022 as published".into(),
        ("belcour", _) => "Belcour 2022".into(),
        ("linear", _) => "linear (this program)".into(),
        ("local", _) => "local (this program)".into(),
        ("sh_prt_vertex", _) => "SH PRT per vertex".into(),
        ("sh_prt_texel", _) => "SH PRT per texel".into(),
        (other, _) => other.into(),
    }
}

impl Page {
    pub fn to_html(&self) -> String {
        let mut scenarios: Vec<&str> = self.rows.iter().map(|r| r.scenario.as_str()).collect();
        scenarios.dedup();
        html! {
            (DOCTYPE)
            html lang="en" {
                head {
                    meta charset="utf-8";
                    meta name="viewport" content="width=device-width";
                    title { (self.title) }
                    style { (PreEscaped(STYLE)) }
                }
                body {
                    h1 { (self.title) }
                    dl.facts {
                        @for (name, value) in &self.facts { div { dt { (name) } dd { (value) } } }
                    }
                    h2 { "Error on lights never seen" }
                    p {
                        "Relative RMSE of indirect irradiance over the lightmap (area weighted), mean over held-out conditions. Grey: the "
                        "oracle, the truth projected on the same basis, which no transfer can better. "
                        i { "Total" } " compares direct and indirect light together: the data-driven methods take direct light from the "
                        "renderer as it is, SH PRT reconstructs it, too. SH PRT knows distant light only: a light near the asset is "
                        "projected as it is seen from the asset's centre, which is where the classical method ends."
                    }
                    @for scenario in scenarios { (table(scenario, &self.rows)) }
                    h2 { "Plots" }
                    div.plots {
                        @for plot in &self.plots {
                            figure { h3 { (plot.title) } (PreEscaped(&plot.svg)) figcaption { (plot.note) } }
                        }
                    }
                    @for plate in &self.plates { (self::plate(plate)) }
                }
            }
        }
        .into_string()
    }
}

fn table(scenario: &str, rows: &[Row]) -> Markup {
    let rows: Vec<&Row> = rows.iter().filter(|r| r.scenario == scenario).collect();
    let percent = |x: f64| format!("{:.1} %", 100.0 * x);
    html! {
        h3 { "Scenario: " (scenario) }
        table {
            thead {
                tr {
                    th { "method" } th { "coefficients" } th { "bytes a texel" } th { "mean" } th { "median" } th { "worst" } th { "oracle" } th { "total" }
                    th { "λ" }
                }
            }
            @for (i, row) in rows.iter().enumerate() {
                @let first = i == 0 || (rows[i - 1].method, rows[i - 1].lambda_choice) != (row.method, row.lambda_choice);
                tr.first[first] {
                    td.method { @if first { (method_label(row.method, row.lambda_choice)) } }
                    td { (row.coefficients) }
                    td { @if let Some(bytes) = row.bytes_per_texel { (bytes) } }
                    td.mean { (percent(row.mean)) }
                    td { (percent(row.median)) }
                    td { (percent(row.worst)) }
                    td.oracle { @if let Some(oracle) = row.oracle_mean { (percent(oracle)) } }
                    td { (percent(row.total_mean)) }
                    td.oracle { @if let Some(lambda) = row.lambda { (format!("{lambda:.1e}")) } }
                }
            }
        }
    }
}

fn plate(plate: &Plate) -> Markup {
    html! {
        h2 { (plate.title) }
        p { (plate.note) }
        div.plate.pixelated[plate.pixelated] {
            @for row in &plate.rows {
                div.row style=(format!("grid-template-columns: repeat({}, 1fr)", row.len().max(1))) {
                    @for image in row {
                        figure {
                            img src=(format!("data:image/png;base64,{}", STANDARD.encode(&image.png))) alt=(image.caption);
                            figcaption { (image.caption) }
                        }
                    }
                }
            }
        }
    }
}

const STYLE: &str = "
body { font: 16px/1.5 system-ui, sans-serif; color: #1a1a1a; background: #fff; max-width: 1180px; margin: 0 auto; padding: 24px 20px 80px; }
h1 { font-size: 30px; margin: 0 0 12px; } h2 { font-size: 22px; margin: 44px 0 8px; } h3 { font-size: 16px; margin: 20px 0 6px; }
p { max-width: 80ch; margin: 6px 0 12px; }
dl.facts { display: flex; flex-wrap: wrap; gap: 6px 28px; margin: 0; } dl.facts div { display: flex; gap: 8px; }
dt { color: #666; } dd { margin: 0; font-variant-numeric: tabular-nums; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: 15px; }
th { text-align: right; font-weight: 600; border-bottom: 2px solid #1a1a1a; padding: 4px 14px; } th:first-child { text-align: left; }
td { text-align: right; padding: 2px 14px; } td.method { text-align: left; } td.mean { font-weight: 600; } td.oracle { color: #767676; }
tr.first td { border-top: 1px solid #ccc; padding-top: 6px; }
.plots { display: grid; grid-template-columns: repeat(auto-fit, minmax(480px, 1fr)); gap: 12px 24px; }
.plots h3 { text-align: left; }
figure { margin: 0; text-align: center; } figcaption { font-size: 13px; color: #444; line-height: 1.35; padding: 3px 2px 8px; }
.plots figcaption { text-align: left; font-size: 14px; }
.row { display: grid; gap: 8px; } img { width: 100%; display: block; border-radius: 2px; } .pixelated img { image-rendering: pixelated; }
svg.plot { width: 100%; height: auto; }
";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn page_escapes_text_and_embeds_images() {
        let image = Image { caption: "a < b".into(), png: vec![1, 2, 3] };
        let page = Page {
            title: "<script>".into(),
            facts: vec![("texels".into(), "12".into())],
            rows: vec![],
            plots: vec![],
            plates: vec![Plate { title: "t".into(), note: "n".into(), rows: vec![vec![image]], pixelated: false }],
        };
        let html = page.to_html();
        assert!(html.contains("&lt;script&gt;") && !html.contains("<script>"));
        assert!(html.contains("data:image/png;base64,AQID") && html.contains("a &lt; b"));
        assert!(!html.contains("http"), "the page must need nothing from outside");
    }
}
