//! How much memory there is, and how much is taken.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// An amount of memory; read and written with a binary unit, such as `512MiB`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Bytes(pub u64);

impl TryFrom<String> for Bytes {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<Bytes> for String {
    fn from(bytes: Bytes) -> Self {
        // To the byte, where what is shown is rounded.
        bytes.0.to_string()
    }
}

const UNITS: [(&str, u32); 5] = [("TiB", 40), ("GiB", 30), ("MiB", 20), ("KiB", 10), ("B", 0)];

impl fmt::Display for Bytes {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let (unit, shift) = UNITS.into_iter().find(|&(_, shift)| self.0 >> shift > 0).unwrap_or(("B", 0));
        let value = self.0 as f64 / (1u64 << shift) as f64;
        // Rounded up, so that an amount that is asked for suffices.
        if value.fract() == 0.0 {
            write!(f, "{value}{unit}")
        } else {
            write!(f, "{:.1}{unit}", (value * 10.0).ceil() / 10.0)
        }
    }
}

impl FromStr for Bytes {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (number, unit) = text.split_at(text.find(|c: char| c.is_ascii_alphabetic()).unwrap_or(text.len()));
        let shift = match unit.trim().to_ascii_lowercase().trim_end_matches("ib") {
            "" | "b" => Some(0),
            "k" => Some(10),
            "m" => Some(20),
            "g" => Some(30),
            "t" => Some(40),
            _ => None,
        };
        match (number.trim().parse::<f64>(), shift) {
            (Ok(number), Some(shift)) if number > 0.0 && number < 1e9 => {
                Ok(Self((number * (1u64 << shift) as f64) as u64))
            }
            _ => Err("expected an amount such as 512MiB or 8GiB".into()),
        }
    }
}

impl Bytes {
    /// A ceiling for this machine: three quarters of its memory, or of what this process's control group may use.
    pub fn of_machine() -> Self {
        let groups = ["/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes"];
        let group = groups.iter().find_map(|file| std::fs::read_to_string(file).ok()?.trim().parse::<u64>().ok());
        // Where the system does not tell, what any machine has that bakes.
        let machine = kibibytes("/proc/meminfo", "MemTotal:").unwrap_or(4 << 30);
        Self(machine.min(group.unwrap_or(u64::MAX)) / 4 * 3)
    }

    /// Resident memory of this process now; 0 where the system does not tell.
    pub fn resident() -> Self {
        Self(kibibytes("/proc/self/status", "VmRSS:").unwrap_or(0))
    }

    /// Largest resident memory of this process so far, where the system tells.
    pub fn peak() -> Option<u64> {
        kibibytes("/proc/self/status", "VmHWM:")
    }
}

/// The value, in bytes, of a line such as `VmRSS:  1234 kB`.
fn kibibytes(file: &str, name: &str) -> Option<u64> {
    let text = std::fs::read_to_string(file).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok().map(|kib| kib * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn amounts_are_read_and_written() {
        let cases = [("64MiB", 64 << 20), ("8GiB", 8 << 30), ("1.5g", 3 << 29), ("512 mib", 512 << 20), ("4096", 4096)];
        for (text, bytes) in cases {
            assert_eq!(text.parse(), Ok(Bytes(bytes)));
            assert_eq!(Bytes(bytes).to_string().parse(), Ok(Bytes(bytes)));
        }
        for wrong in ["", "MiB", "-1GiB", "0", "8Gob", "inf", "1e99GiB"] {
            assert!(wrong.parse::<Bytes>().is_err(), "{wrong}");
        }
    }
}
