//! The HTML page: one file that needs nothing beside it.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use maud::{DOCTYPE, Markup, PreEscaped, html};

/// A picture with what it shows.
#[derive(Clone)]
pub struct Image {
    pub caption: String,
    pub png: Vec<u8>,
}

/// Pictures that are read together, in rows.
pub struct Plate {
    pub rows: Vec<Vec<Image>>,
    /// Whether pixels are to be seen (lightmaps) or smoothed (renders).
    pub pixelated: bool,
}

/// A plot as SVG.
pub struct Plot {
    /// Of its file, without ending.
    pub name: String,
    pub title: String,
    pub note: String,
    pub svg: String,
}

/// A table: text, and in the cells of a matrix of errors a fraction that shades them.
pub struct Table {
    pub title: String,
    pub header: Vec<String>,
    pub rows: Vec<Vec<Cell>>,
}

/// A cell of a [`Table`].
#[derive(Clone, Debug, Default)]
pub struct Cell {
    pub text: String,
    /// From 0 (white) to 1 (dark).
    pub shade: Option<f64>,
    /// How it is set, if not as usual: "name", "strong", "quiet".
    pub class: &'static str,
    /// Whether a group of rows begins here.
    pub first: bool,
}

impl Cell {
    pub fn new(text: impl Into<String>) -> Self {
        Self { text: text.into(), ..Self::default() }
    }

    pub fn name(text: impl Into<String>) -> Self {
        Self { class: "name", ..Self::new(text) }
    }

    pub fn percent(value: f64) -> Self {
        Self::new(percent(value))
    }
}

/// A fraction as percent, with a digit after the point.
pub fn percent(value: f64) -> String {
    format!("{:.1} %", 100.0 * value)
}

/// Part of a section.
pub enum Block {
    Plots(Vec<Plot>),
    Table(Table),
    Plate(Plate),
}

/// A figure, or another part of the page, with its data.
#[derive(Default)]
pub struct Section {
    pub title: String,
    /// What the paper's figure shows, if it is one of the paper's.
    pub paper: Option<&'static str>,
    /// What this one shows.
    pub here: String,
    pub blocks: Vec<Block>,
    /// File name and text (CSV).
    pub data: Vec<(String, String)>,
}

/// Sections under one heading.
pub struct Chapter {
    pub title: String,
    pub note: String,
    pub sections: Vec<Section>,
}

/// All that the page shows.
pub struct Page {
    pub title: String,
    /// Name and value, as "texels: 14,336".
    pub facts: Vec<(String, String)>,
    pub chapters: Vec<Chapter>,
}

/// Names that readers know the methods by.
pub fn method_label(method: &str, lambda_choice: Option<&str>) -> String {
    match (method, lambda_choice) {
        ("belcour", Some("leave-one-out")) => "Belcour 2022, λ found".into(),
        ("belcour", Some("published")) => "Belcour 2022, published".into(),
        ("belcour", _) => "Belcour 2022".into(),
        ("linear", _) => "linear (ours)".into(),
        ("local", _) => "local (ours)".into(),
        ("sh_prt_vertex", _) => "SH PRT per vertex".into(),
        ("sh_prt_texel", _) => "SH PRT per texel".into(),
        (other, _) => other.into(),
    }
}

/// The colour that a method has in all plots.
pub fn method_colour(method: &str, lambda_choice: Option<&str>) -> usize {
    match (method, lambda_choice) {
        ("linear", _) => 0,
        ("local", _) => 1,
        ("belcour", Some("leave-one-out")) => 3,
        ("belcour", _) => 2,
        ("sh_prt_vertex", _) => 4,
        _ => 5,
    }
}

impl Page {
    pub fn to_html(&self) -> String {
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
                    @for chapter in &self.chapters {
                        h2 { (chapter.title) }
                        @if !chapter.note.is_empty() { p { (chapter.note) } }
                        @for section in &chapter.sections { (self::section(section)) }
                    }
                }
            }
        }
        .into_string()
    }
}

fn section(section: &Section) -> Markup {
    html! {
        section {
            @if !section.title.is_empty() { h3 { (section.title) } }
            @if let Some(paper) = section.paper { p.paper { b { "The paper: " } (paper) } }
            @if !section.here.is_empty() {
                p { @if section.paper.is_some() { b { "Here: " } } (section.here) }
            }
            @for block in &section.blocks {
                @match block {
                    Block::Plots(plots) => div.plots {
                        @for plot in plots {
                            figure { h4 { (plot.title) } (PreEscaped(&plot.svg)) figcaption { (plot.note) } }
                        }
                    },
                    Block::Table(table) => (self::table(table)),
                    Block::Plate(plate) => (self::plate(plate)),
                }
            }
            @if !section.data.is_empty() {
                p.data { "Data: " @for (i, (name, _)) in section.data.iter().enumerate() { @if i > 0 { ", " } a href=(name) { (name) } } }
            }
        }
    }
}

fn table(table: &Table) -> Markup {
    let class = |column: usize| table.rows.first().and_then(|row| row.get(column)).map_or("", |cell| cell.class);
    html! {
        @if !table.title.is_empty() { h4 { (table.title) } }
        div.wide {
            table {
                thead { tr { @for (i, name) in table.header.iter().enumerate() { th class=(class(i)) { (name) } } } }
                @for row in &table.rows {
                    tr.first[row.first().is_some_and(|c| c.first)] {
                        @for cell in row { td class=(cell.class) style=[cell.shade.map(shade)] { (cell.text) } }
                    }
                }
            }
        }
    }
}

/// From white to a dark blue, with text that can be read on it.
fn shade(value: f64) -> String {
    let t = value.clamp(0.0, 1.0);
    let channel = |to: f64| (255.0 + (to - 255.0) * t).round();
    let text = if t > 0.55 { "#fff" } else { "#1a1a1a" };
    format!("background: rgb({} {} {}); color: {text}", channel(8.0), channel(64.0), channel(129.0))
}

fn plate(plate: &Plate) -> Markup {
    // All pictures of a plate are of one size.
    let columns = plate.rows.iter().map(Vec::len).max().unwrap_or(1);
    html! {
        div.plate.pixelated[plate.pixelated] {
            @for row in &plate.rows {
                div.row style=(format!("grid-template-columns: repeat({columns}, 1fr)")) {
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
h1 { font-size: 30px; margin: 0 0 12px; } h2 { font-size: 24px; margin: 52px 0 8px; border-bottom: 1px solid #ccc; padding-bottom: 4px; }
h3 { font-size: 18px; margin: 30px 0 4px; } h4 { font-size: 15px; margin: 14px 0 4px; text-align: left; }
p { max-width: 90ch; margin: 4px 0 8px; } p.paper { color: #444; } p.data { font-size: 13px; color: #666; }
dl.facts { display: flex; flex-wrap: wrap; gap: 6px 28px; margin: 0; } dl.facts div { display: flex; gap: 8px; }
dt { color: #666; } dd { margin: 0; font-variant-numeric: tabular-nums; }
.wide { overflow-x: auto; } table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: 14px; margin: 6px 0 12px; }
th { text-align: right; vertical-align: bottom; font-weight: 600; border-bottom: 2px solid #1a1a1a; padding: 4px 11px; } th.name, th:first-child { text-align: left; }
td { text-align: right; padding: 2px 11px; white-space: nowrap; } td.name { text-align: left; } td.strong { font-weight: 600; } td.quiet { color: #6b6b6b; }
tr.first td { border-top: 1px solid #ccc; padding-top: 6px; }
.plots { display: grid; grid-template-columns: repeat(auto-fill, minmax(480px, 1fr)); gap: 12px 24px; }
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
        let plate = Plate { rows: vec![vec![image]], pixelated: false };
        let shaded = Cell { shade: Some(1.0), ..Cell::percent(0.5) };
        let table = Table { title: "t".into(), header: vec!["h & h".into()], rows: vec![vec![shaded]] };
        let section = Section {
            title: "s".into(),
            paper: Some("p"),
            here: "h".into(),
            blocks: vec![Block::Plate(plate), Block::Table(table)],
            data: vec![("d.csv".into(), String::new())],
        };
        let page = Page {
            title: "<script>".into(),
            facts: vec![("texels".into(), "12".into())],
            chapters: vec![Chapter { title: "c".into(), note: "n".into(), sections: vec![section] }],
        };
        let html = page.to_html();
        assert!(html.contains("&lt;script&gt;") && !html.contains("<script>"));
        assert!(html.contains("data:image/png;base64,AQID") && html.contains("a &lt; b"));
        assert!(html.contains("h &amp; h") && html.contains("50.0 %") && html.contains("rgb(8 64 129)"));
        assert!(html.contains("<a href=\"d.csv\">"));
        assert!(!html.contains("http"), "the page must need nothing from outside");
    }
}
