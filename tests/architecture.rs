//! The house's plan, read from the source: data flows one way, and a file is one idea.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Most lines of a product file, its own tests included.
const MOST_LINES: usize = 600;

/// What a room never imports although the order of rooms would allow it.
const NEVER: [(&str, &[&str]); 6] = [
    ("transport", &["gpu"]),
    ("dataset", &["gpu"]),
    ("transfer", &["scene", "gpu"]),
    ("prt", &["transfer", "gpu"]),
    ("report", &["gpu"]),
    ("viewer", &["transport", "transfer"]),
];

fn source() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src")
}

/// Every Rust file below `folder`.
fn files_below(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files.extend(files_below(&path));
        } else if path.extension().is_some_and(|e| e == "rs") {
            files.push(path);
        }
    }
    files.sort();
    files
}

/// The room of a file: the first part of its path in `src`. `main.rs` and `lib.rs` are no rooms.
fn room(file: &Path) -> String {
    let first = file.strip_prefix(source()).unwrap().components().next().unwrap();
    first.as_os_str().to_str().unwrap().trim_end_matches(".rs").to_owned()
}

/// The code that is built into the product: no comments, and nothing from the file's test module, which ends it.
fn product_code(text: &str) -> String {
    let code = text.split("#[cfg(test)]").next().unwrap();
    code.lines().map(|line| line.split("//").next().unwrap()).collect::<Vec<_>>().join("\n")
}

/// Rooms that `code` names in `crate::room` and `crate::{room::…, room}` paths.
fn imports(code: &str) -> BTreeSet<String> {
    let mut rooms = BTreeSet::new();
    for after in code.split("crate::").skip(1) {
        let Some(group) = after.strip_prefix('{') else {
            rooms.insert(identifier(after));
            continue;
        };
        // The group's own level: what nested braces hold belongs to the room before them.
        let mut depth = 1;
        let mut part = String::new();
        for letter in group.chars() {
            match letter {
                '{' => depth += 1,
                '}' => depth -= 1,
                ',' if depth == 1 => {
                    rooms.insert(identifier(std::mem::take(&mut part).trim()));
                }
                other if depth == 1 => part.push(other),
                _ => {}
            }
            if depth == 0 {
                break;
            }
        }
        rooms.insert(identifier(part.trim()));
    }
    rooms.remove("");
    rooms
}

fn identifier(text: &str) -> String {
    text.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect()
}

/// The names that lines of `src/lib.rs` hold between `before` and `after`.
fn names(before: &str, after: &str) -> Vec<String> {
    let text = std::fs::read_to_string(source().join("lib.rs")).unwrap();
    let name = |line: &str| Some(line.trim().strip_prefix(before)?.split_once(after)?.0.to_owned());
    text.lines().filter_map(name).collect()
}

/// What of `code` in `room` is imported against the order of rooms, or against [`NEVER`].
fn violations(rooms: &[String], room: &str, code: &str) -> Vec<String> {
    let position = |name: &str| rooms.iter().position(|r| r == name);
    let here = position(room);
    let never = NEVER.iter().find(|(from, _)| *from == room).map_or(&[][..], |(_, never)| never);
    let allowed = |to: &String| to == room || (position(to) < here && !never.contains(&to.as_str()));
    // A path such as `crate::Thing` names no room.
    imports(code).into_iter().filter(|to| position(to).is_some()).filter(|to| !allowed(to)).collect()
}

#[test]
fn rooms_import_only_from_rooms_above() {
    let rooms = names("pub mod ", ";");
    let mut found = Vec::new();
    let mut seen = BTreeSet::new();
    for file in files_below(&source()) {
        let room = room(&file);
        if ["main", "lib"].contains(&room.as_str()) {
            continue;
        }
        let code = product_code(&std::fs::read_to_string(&file).unwrap());
        found.extend(violations(&rooms, &room, &code).iter().map(|to| format!("{} imports {to}", file.display())));
        seen.insert(room);
    }
    assert!(found.is_empty(), "{found:#?}");
    assert_eq!(seen, rooms.iter().cloned().collect(), "each room of src/lib.rs is there, and no other");
    // Controls: an import from below, one that is never allowed, and one in a group are told.
    assert_eq!(violations(&rooms, "math", "use crate::scene::Mesh;"), ["scene"]);
    assert_eq!(violations(&rooms, "report", "let x = crate::gpu::Runtime::new();"), ["gpu"]);
    assert_eq!(violations(&rooms, "scene", "use crate::{math::{Frame, Rgb}, light::Light};"), ["light"]);
    assert!(violations(&rooms, "scene", &product_code("// crate::light\n#[cfg(test)]\nuse crate::cli;")).is_empty());
}

#[test]
fn table_and_modules_have_the_same_order() {
    assert_eq!(names("//! | [`", "`]"), names("pub mod ", ";"));
    assert_eq!(names("pub mod ", ";").first().map(String::as_str), Some("math"));
    assert_eq!(names("pub mod ", ";").last().map(String::as_str), Some("cli"));
}

#[test]
fn a_file_is_one_idea() {
    for file in files_below(&source()) {
        let lines = std::fs::read_to_string(&file).unwrap().lines().count();
        assert!(lines <= MOST_LINES, "{} has {lines} lines, more than {MOST_LINES}: two ideas", file.display());
    }
}
