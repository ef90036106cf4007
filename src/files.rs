//! Files: read as what they are to hold, and written so that nothing half-written is ever seen.

use std::io::{self, Write};
use std::path::Path;

/// Reads what a file says in TOML, or in JSON where its name ends in .json.
///
/// # Errors
/// One line that names the file, and where in it something is wrong.
#[cfg(feature = "train")]
pub fn read_words<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T, String> {
    let file = path.display();
    let text = std::fs::read_to_string(path).map_err(|e| format!("{file}: cannot be read: {e}"))?;
    if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("json")) {
        serde_json::from_str(&text).map_err(|e| format!("{file}: {e}"))
    } else {
        toml::from_str(&text).map_err(|e| format!("{file}: {}", toml_error_line(&text, &e)))
    }
}

/// A TOML error in one line, with the line's number.
#[cfg(feature = "train")]
pub fn toml_error_line(text: &str, error: &toml::de::Error) -> String {
    let line = error.span().map(|span| text[..span.start.min(text.len())].matches('\n').count() + 1);
    let message = error.message().replace('\n', " ");
    line.map_or(message.clone(), |line| format!("line {line}: {message}"))
}

/// Writes `bytes` beside `path` and renames them into place; folders that are missing are made.
pub fn write_whole(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder)?;
    let mut builder = tempfile::Builder::new();
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // Temporary files are private by default; a result gets what the umask leaves.
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    let mut file = builder.tempfile_in(folder)?;
    file.write_all(bytes)?;
    file.as_file().sync_all()?;
    file.persist(path)?;
    Ok(())
}

/// Whether a file at `path` could be written later: no folder has its name, and the nearest folder that exists above it
/// takes new files. To be asked before long work whose result goes there.
pub fn check_writable(path: &Path) -> io::Result<()> {
    if path.is_dir() {
        return Err(io::ErrorKind::IsADirectory.into());
    }
    let above =
        path.ancestors().skip(1).map(|folder| if folder.as_os_str().is_empty() { Path::new(".") } else { folder });
    let existing = above.into_iter().find(|folder| folder.exists()).unwrap_or(Path::new("."));
    tempfile::tempfile_in(existing).map(|_| ())
}
