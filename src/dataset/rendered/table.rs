//! D as a table: `direct.safetensors`, `direct.npy` or `direct.csv`.

use std::path::Path;

use safetensors::{Dtype, SafeTensors};

/// Names of the files that may hold D.
pub const FILES: [&str; 3] = ["direct.safetensors", "direct.npy", "direct.csv"];

/// D of `points` points under `conditions` conditions, `[point][condition][channel]`.
///
/// # Errors
/// What is wrong with the file: another form or shape, a value that is no light.
pub fn read(path: &Path, points: usize, conditions: usize) -> Result<Vec<f32>, String> {
    let bytes = std::fs::read(path).map_err(|e| format!("cannot be read: {e}"))?;
    let shape = [points, conditions, 3];
    let values = match path.extension().and_then(|e| e.to_str()) {
        Some("npy") => npy(&bytes, &shape)?,
        Some("csv") => csv(&bytes, points, conditions)?,
        _ => tensor(&bytes, &shape)?,
    };
    if let Some(i) = values.iter().position(|v| !v.is_finite() || *v < 0.0) {
        let (point, condition, value) = (i / (3 * conditions), i / 3 % conditions, values[i]);
        return Err(format!("point {point} under condition {condition} has {value}, which is no light"));
    }
    Ok(values)
}

fn check_shape(found: &[usize], shape: &[usize; 3]) -> Result<(), String> {
    let [points, conditions, _] = shape;
    let why = format!("is of shape {found:?}, expected {shape:?}: {points} points, {conditions} conditions, RGB");
    if found == shape { Ok(()) } else { Err(why) }
}

/// The tensor `direct`.
fn tensor(bytes: &[u8], shape: &[usize; 3]) -> Result<Vec<f32>, String> {
    let file = SafeTensors::deserialize(bytes).map_err(|e| format!("does not parse: {e}"))?;
    let tensor = file.tensor("direct").map_err(|_| "has no tensor `direct`".to_owned())?;
    check_shape(tensor.shape(), shape)?;
    numbers(tensor.data(), tensor.dtype() == Dtype::F64, matches!(tensor.dtype(), Dtype::F32 | Dtype::F64))
}

/// Little-endian numbers, f64 where `double`, else f32.
fn numbers(bytes: &[u8], double: bool, known: bool) -> Result<Vec<f32>, String> {
    if !known {
        return Err("holds numbers of another kind than 32- or 64-bit floats".into());
    }
    Ok(match double {
        true => bytes.as_chunks::<8>().0.iter().map(|b| f64::from_le_bytes(*b) as f32).collect(),
        false => bytes.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect(),
    })
}

/// NumPy's own format (numpy.lib.format, versions 1 to 3).
fn npy(bytes: &[u8], shape: &[usize; 3]) -> Result<Vec<f32>, String> {
    let cut = || "is shorter than its header says".to_owned();
    let rest = bytes.strip_prefix(b"\x93NUMPY").ok_or("is not in NumPy's format")?;
    let (start, length) = match rest.first().ok_or_else(cut)? {
        1 => (4, rest.get(2..4).map(|b| u16::from_le_bytes([b[0], b[1]]) as usize)),
        _ => (6, rest.get(2..6).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize)),
    };
    let end = start + length.ok_or_else(cut)?;
    let header = String::from_utf8_lossy(rest.get(start..end).ok_or_else(cut)?).replace(' ', "");
    let after = |key: &str| header.split_once(&format!("'{key}':")).map(|(_, after)| after);
    let found = after("shape").and_then(|s| s.strip_prefix('(')?.split_once(')')).map(|(inside, _)| inside);
    let found: Vec<usize> = found.unwrap_or_default().split(',').flat_map(str::parse).collect();
    check_shape(&found, shape)?;
    if !after("fortran_order").is_some_and(|s| s.starts_with("False")) {
        return Err("is stored column by column; save numpy.ascontiguousarray(D)".into());
    }
    let kind = after("descr").and_then(|s| s.strip_prefix('\'')?.split_once('\'')).map_or("", |(kind, _)| kind);
    let data = &rest[end..];
    let double = kind == "<f8";
    if data.len() != shape.iter().product::<usize>() * if double { 8 } else { 4 } {
        return Err(cut());
    }
    numbers(data, double, ["<f4", "<f8"].contains(&kind))
}

/// Lines `point,condition,r,g,b` under that header, each pair once, in any order.
fn csv(bytes: &[u8], points: usize, conditions: usize) -> Result<Vec<f32>, String> {
    const HEADER: &str = "point,condition,r,g,b";
    let text = std::str::from_utf8(bytes).map_err(|_| "is not text")?;
    let mut lines = text.lines().enumerate().map(|(i, line)| (i + 1, line.trim())).filter(|(_, line)| !line.is_empty());
    if lines.next().is_none_or(|(_, line)| line.replace(' ', "") != HEADER) {
        return Err(format!("does not begin with the line {HEADER}"));
    }
    let mut values = vec![0f32; points * conditions * 3];
    let mut seen = vec![false; points * conditions];
    for (number, line) in lines {
        let fields: Vec<&str> = line.split(',').map(str::trim).collect();
        let index = |i: usize, below: usize| fields.get(i)?.parse::<usize>().ok().filter(|&v| v < below);
        let rgb: Option<Vec<f32>> =
            fields.get(2..5).filter(|_| fields.len() == 5).and_then(|f| f.iter().map(|v| v.parse().ok()).collect());
        let (Some(point), Some(condition), Some(rgb)) = (index(0, points), index(1, conditions), rgb) else {
            return Err(format!(
                "line {number} is not a point below {points}, a condition below {conditions} and three numbers"
            ));
        };
        let pair = point * conditions + condition;
        if std::mem::replace(&mut seen[pair], true) {
            return Err(format!("line {number} has point {point} under condition {condition} again"));
        }
        values[3 * pair..3 * pair + 3].copy_from_slice(&rgb);
    }
    match seen.iter().position(|seen| !seen) {
        Some(pair) => Err(format!("has no line for point {} under condition {}", pair / conditions, pair % conditions)),
        None => Ok(values),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use safetensors::tensor::TensorView;

    const SHAPE: [usize; 3] = [2, 3, 3];

    fn values() -> Vec<f32> {
        (0..18).map(|i| i as f32 * 0.5).collect()
    }

    fn npy_of(descr: &str, order: &str, shape: &str, data: &[u8]) -> Vec<u8> {
        let header = format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}\n");
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.bytes());
        bytes.extend(data);
        bytes
    }

    #[test]
    fn the_three_forms_hold_the_same_table() {
        let folder = tempfile::tempdir().unwrap();
        let put = |name: &str, bytes: &[u8]| {
            let path = folder.path().join(name);
            std::fs::write(&path, bytes).unwrap();
            read(&path, 2, 3)
        };
        let expected = Ok(values());
        let view = TensorView::new(Dtype::F32, SHAPE.to_vec(), bytemuck::cast_slice(&expected.as_ref().unwrap()[..]));
        let bytes = safetensors::serialize([("direct", view.unwrap())], None).unwrap();
        assert_eq!(put("direct.safetensors", &bytes), expected);
        let floats: Vec<u8> = values().iter().flat_map(|v| v.to_le_bytes()).collect();
        let doubles: Vec<u8> = values().iter().flat_map(|v| (*v as f64).to_le_bytes()).collect();
        assert_eq!(put("direct.npy", &npy_of("<f4", "False", "(2, 3, 3)", &floats)), expected);
        assert_eq!(put("direct.npy", &npy_of("<f8", "False", "(2, 3, 3)", &doubles)), expected);
        let line = |i: usize| {
            let v = values();
            format!("{},{},{},{},{}", i / 3, i % 3, v[3 * i], v[3 * i + 1], v[3 * i + 2])
        };
        let lines: Vec<String> = (0..6).rev().map(line).collect();
        assert_eq!(put("direct.csv", format!("point,condition,r,g,b\n{}\n", lines.join("\n")).as_bytes()), expected);

        for (name, bytes, part) in [
            ("direct.npy", npy_of("<f4", "False", "(3, 2, 3)", &floats), "[3, 2, 3]"),
            ("direct.npy", npy_of("<f4", "True", "(2, 3, 3)", &floats), "column by column"),
            ("direct.npy", npy_of("<i4", "False", "(2, 3, 3)", &floats), "another kind"),
            ("direct.npy", npy_of("<f4", "False", "(2, 3, 3)", &floats[4..]), "shorter"),
            ("direct.npy", b"\x93NUMPY\x01".to_vec(), "shorter"),
            ("direct.npy", b"text".to_vec(), "NumPy"),
            ("direct.safetensors", b"text".to_vec(), "parse"),
            ("direct.csv", b"1,2,3".to_vec(), "begin"),
            (
                "direct.csv",
                format!("point,condition,r,g,b\n{}", lines[1..].join("\n")).into(),
                "no line for point 1 under condition 2",
            ),
            ("direct.csv", format!("point,condition,r,g,b\n{0}\n{0}", lines[0]).into(), "again"),
            ("direct.csv", "point,condition,r,g,b\n0,3,1,1,1".to_owned().into(), "line 2"),
            ("direct.csv", "point,condition,r,g,b\n0,0,1,x,1".to_owned().into(), "line 2"),
        ] {
            let error = put(name, &bytes).unwrap_err();
            assert!(error.contains(part) && !error.contains('\n'), "{name}: {error}");
        }
        let mut dark = values();
        dark[10] = f32::NAN;
        let bytes: Vec<u8> = dark.iter().flat_map(|v| v.to_le_bytes()).collect();
        let error = put("direct.npy", &npy_of("<f4", "False", "(2, 3, 3)", &bytes)).unwrap_err();
        assert!(error.contains("point 1 under condition 0"), "{error}");
    }
}
