fn main() -> std::process::ExitCode {
    relight::cli::run()
}
