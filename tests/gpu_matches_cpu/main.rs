//! Every stage on the GPU against its twin on the CPU. Without an adapter these tests are reported as ignored.
//!
//! Each comparison returns what differs, so that its control, a comparison that must fail, runs the same code.

mod display;
mod embedded;
#[path = "../common/host.rs"]
mod host;
mod measure;
mod picture;
#[path = "../common/room.rs"]
mod room;
mod scenes;
mod transfer;

use libtest_mimic::{Arguments, Failed, Trial};
use relight::gpu::{Gpu, GpuError};

const EPSILON: f32 = f32::EPSILON;

fn main() {
    // Any other failure is the tests' to report.
    let absent = match Gpu::new() {
        Err(error @ GpuError::NoAdapter { .. }) => {
            eprintln!("GPU tests are ignored: {error}");
            true
        }
        _ => false,
    };
    let trial = |name: &str, body: fn()| {
        let run = move || -> Result<(), Failed> {
            body();
            Ok(())
        };
        Trial::test(name, run).with_ignored_flag(absent)
    };
    let trials = vec![
        trial("measure_matches_direct_light_of_every_kind", measure::measure),
        trial("measure_matches_for_lights_of_many_parts", measure::measure_parts),
        trial("downsample_averages_the_same_neighbours", measure::downsample),
        trial("transfer_matches_for_mono_multi_and_mean", transfer::transfer),
        trial("reconstruct_matches_for_global_and_local_bases", transfer::reconstruct),
        trial("basis_lookup_matches", transfer::basis_lookup),
        trial("whole_picture_matches", picture::whole_picture),
        trial("a_hosts_shader_gets_the_light_of_the_texture_and_the_cpu", embedded::embedded),
        trial("a_host_may_measure_by_itself", embedded::host_measures),
        trial("sixty_four_elements_fit_default_limits", embedded::sixty_four_elements),
        trial("every_stage_matches_on_every_scene", scenes::scenes),
        trial("many_lights_fit_after_few", measure::many_lights),
        trial("the_window_shows_pictures_references_and_differences", display::display),
        trial("absurd_views_are_refused_and_leave_the_runtime_usable", picture::absurd_views),
    ];
    libtest_mimic::run(&Arguments::from_args(), trials).exit();
}
