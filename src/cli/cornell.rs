//! `relight` without a command: the Cornell box, trained, compared and explained.

use std::path::Path;
use std::time::Instant;

use super::compare::{Scope, compare};
use super::pipeline::prepare;
use super::storage::Storage;
use super::train::{default_output, figures, print_summary};
use super::{Failure, Reporter};
use crate::scene_file::SceneFile;

pub fn run(json: Option<&Path>, reporter: &Reporter) -> Result<(), Failure> {
    let start = Instant::now();
    let prepared = prepare(SceneFile::cornell(), "cornell", reporter)?;
    let output = default_output(&prepared.asset.name);
    let place = Storage::default().place(&output)?;
    let trained = prepared.train(&place, reporter)?;
    let bytes = trained.model.save(&output)?;
    print_summary(&trained, &output, bytes);
    let figures = figures(&trained, bytes, start.elapsed().as_secs_f64());
    compare(&prepared, &trained, &place, Path::new("out"), Scope::QUICK, None, reporter)?;
    say!("done in {:.0} s. Next:", start.elapsed().as_secs_f64());
    say!("  open out/report.html in a browser");
    say!("  relight compare {} -o out/compare          the same with all figures, over three seeds", output.display());
    #[cfg(feature = "viewer")]
    say!("  relight view {}                     a window: move lights, see indirect light follow", output.display());
    say!("  relight train YOUR.glb -o out/yours.relight        train a transfer for your own asset");
    say!(
        "  relight render {} --light '{{type=\"point\", position=[2.8,4,2], intensity=20}}' -o out/relit.png",
        output.display()
    );
    say!("  relight --help                                      everything else (cargo run --release -- --help)");
    super::write_json(json, &figures)
}
