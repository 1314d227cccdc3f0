//! How real-time privileges are granted: the files of `supervisor/grants`, as lines for a
//! terminal. What `doctor` prints is read out of the files themselves.

use crate::machine::programs::own_folder;
use crate::set::table::TABLE;

/// Limits of a user, for pam_limits.
pub const LIMITS: &str = include_str!("../../../grants/limits.conf");
/// Capabilities of the programs.
pub const CAPABILITIES: &str = include_str!("../../../grants/capabilities.sh");
/// The set as a systemd service.
pub const SERVICE: &str = include_str!("../../../../packaging/debian/vlaps.service");

/// Which user may bound the sleep of processors, for udev.
pub const CPU_LATENCY: &str = include_str!("../../../grants/cpu-latency.rules");

/// The ways to grant priority and locked memory; any one is enough.
pub fn lines() -> Vec<String> {
    let limits: Vec<_> = rules(LIMITS).map(|rule| format!("{rule}\\n")).collect();
    let limits = limits.concat().replace("USER", "$USER");
    let capabilities = rules(CAPABILITIES)
        .find(|line| line.trim_start().starts_with("sudo setcap"))
        .unwrap_or_default();
    let programs = rules(CAPABILITIES)
        .find_map(|line| line.strip_prefix("for program in "))
        .and_then(|rest| rest.strip_suffix("; do"))
        .unwrap_or_default()
        .replace(' ', ",");
    let capabilities = capabilities
        .trim()
        .replace("\"$folder/vlaps-$program\"", "")
        .trim_end()
        .to_string();
    let properties: Vec<_> = rules(SERVICE)
        .filter(|line| line.starts_with("Limit"))
        .map(|line| format!("-p {line}"))
        .collect();
    vec![
        "for your user, once; log in again afterwards:".into(),
        format!("  printf \"{limits}\" | sudo tee /etc/security/limits.d/99-vlaps.conf"),
        "or for these programs, after each build:".into(),
        format!("  {capabilities} target/release/vlaps-{{{programs}}}"),
        "or for one run:".into(),
        format!(
            "  sudo systemd-run --pty --same-dir --uid=$USER {} ./vlaps up",
            properties.join(" ")
        ),
        "or as a service, by the Debian package: packaging/build deb".into(),
        "in a container: docker run --cap-add=SYS_NICE --ulimit rtprio=95 --ulimit memlock=-1 --shm-size=1g ..."
            .into(),
    ]
}

/// The capability for locked memory, by its number in `linux/capability.h`.
pub const IPC_LOCK: u32 = 14;
/// The capability for real-time priority.
pub const SYS_NICE: u32 = 23;

/// Whether the files of all programs with a priority hold a capability and make it
/// effective.
pub fn programs_can(capability: u32) -> bool {
    let Ok(folder) = own_folder() else {
        return false;
    };
    let mut rows = TABLE.iter().filter(|row| row.priority > 0);
    rows.all(|row| {
        let mut bytes = [0; CAPABILITIES_MAX];
        let program = folder.join(row.binary);
        let length = rustix::fs::getxattr(program, c"security.capability", &mut bytes[..]);
        length.is_ok_and(|length| holds(&bytes[..length], capability))
    })
}

/// Longest extended attribute of a file's capabilities, bytes.
const CAPABILITIES_MAX: usize = 64;

/// A file's capabilities are 32-bit words, the lowest byte first: the version, whose
/// bit 0 means *effective*, then the permitted capabilities.
fn holds(bytes: &[u8], capability: u32) -> bool {
    let word = |k: usize| {
        let bytes = bytes.get(4 * k..4 * k + 4)?;
        Some(u32::from_le_bytes(bytes.try_into().ok()?))
    };
    match (word(0), word(1)) {
        (Some(format), Some(permitted)) => format & 1 == 1 && permitted >> capability & 1 == 1,
        _ => false,
    }
}

/// How to grant the bound on sleeping processors.
pub fn cpu_latency_lines() -> Vec<String> {
    let rules: Vec<_> = rules(CPU_LATENCY).collect();
    let reload = CPU_LATENCY
        .lines()
        .filter_map(|line| Some(line.strip_prefix('#')?.trim()))
        .find(|line| line.starts_with("sudo udevadm"));
    let rules = rules.join("\\n").replace("\"USER\"", "\"'$USER'\"");
    vec![
        "for your user, once:".into(),
        format!("  printf '{rules}\\n' | sudo tee /etc/udev/rules.d/99-vlaps.rules"),
        format!("  {}", reload.unwrap_or_default()),
    ]
}

/// The lines of a file without comments.
fn rules(text: &str) -> impl Iterator<Item = &str> {
    text.lines()
        .filter(|line| !line.trim_start().starts_with('#') && !line.trim().is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lines_say_what_the_files_say() {
        let text = lines().join("\n");
        for part in [
            "printf \"$USER - rtprio 95\\n$USER - memlock unlimited\\n\" | sudo tee",
            "sudo setcap cap_sys_nice,cap_ipc_lock+ep target/release/vlaps-{world,planner,controller}",
            "-p LimitRTPRIO=95 -p LimitMEMLOCK=infinity ./vlaps up",
        ] {
            assert!(text.contains(part), "'{part}' is missing in\n{text}");
        }
    }

    #[test]
    fn capabilities_of_a_file_are_read_as_setcap_writes_them() {
        // `setcap cap_sys_nice,cap_ipc_lock+ep`, by `getfattr -e hex`.
        let words: [u32; 5] = [0x0200_0001, 0x0080_4000, 0, 0, 0];
        let bytes: Vec<_> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        assert!(holds(&bytes, SYS_NICE) && holds(&bytes, IPC_LOCK));
        assert!(!holds(&bytes, 21) && !holds(&bytes[..7], SYS_NICE) && !holds(&[], SYS_NICE));
        // Permitted, and not effective.
        let idle = [&[0, 0, 0, 2], &bytes[4..]].concat();
        assert!(!holds(&idle, SYS_NICE));
    }

    #[test]
    fn the_rule_names_the_user_and_is_loaded() {
        assert_eq!(
            cpu_latency_lines()[1..],
            [
                "  printf 'KERNEL==\"cpu_dma_latency\", OWNER=\"'$USER'\", MODE=\"0600\"\\n' | sudo tee \
                 /etc/udev/rules.d/99-vlaps.rules",
                "  sudo udevadm control --reload && sudo udevadm trigger --name-match=cpu_dma_latency",
            ]
        );
    }

    #[test]
    fn the_programs_with_capabilities_are_those_with_a_priority() {
        for row in crate::set::table::TABLE {
            let word = row.process.word();
            let line = lines().into_iter().find(|line| line.contains("setcap"));
            let named = line.is_some_and(|line| line.contains(word));
            assert_eq!(named, row.priority > 0, "{word}");
        }
    }
}
