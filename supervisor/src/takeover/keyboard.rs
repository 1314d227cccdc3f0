//! Keys from the terminal the supervisor runs in.

use std::io::{self, IsTerminal, Stdin};

use rustix::event::{PollFd, PollFlags, poll};
use rustix::process::getpgrp;
use rustix::termios::{
    LocalModes, OptionalActions, SpecialCodeIndex, Termios, tcgetattr, tcgetpgrp, tcsetattr,
};
use rustix::time::Timespec;

use crate::cli::failure::Failure;
use crate::takeover::key::Key;

/// Bytes read in one look: far more than a held key sends between two; what is
/// pasted beyond that comes in the next look.
const READ_MAX: usize = 256;

/// A terminal that hands over each key at once, without showing it. It is put
/// back as it was when this is dropped: at the end, after an error, in a panic.
#[derive(Debug)]
pub struct Keyboard {
    stdin: Stdin,
    before: Termios,
    decoder: Decoder,
}

impl Keyboard {
    /// Takes the terminal over.
    ///
    /// # Errors
    /// When stdin is no terminal, or another program has it.
    pub fn open() -> Result<Self, Failure> {
        let refused = |why: &str| {
            Failure::Usage(format!(
                "--gate human: {why}, so nobody can take over; run it in the foreground of a \
                 terminal, or give the keys with --keys FILE"
            ))
        };
        let stdin = io::stdin();
        if !stdin.is_terminal() {
            return Err(refused("stdin is no terminal"));
        }
        if !is_in_foreground(&stdin) {
            return Err(refused("the terminal is another program's"));
        }
        let before = tcgetattr(&stdin).map_err(|error| refused(&error.to_string()))?;
        let mut keys = before.clone();
        // Not ISIG and not OPOST: Ctrl-C still stops, lines still begin at the left.
        keys.local_modes
            .remove(LocalModes::ICANON | LocalModes::ECHO | LocalModes::IEXTEN);
        // A read returns at once, with or without a key. O_NONBLOCK would do so, too,
        // but stdout is the same open file as a rule.
        keys.special_codes[SpecialCodeIndex::VMIN] = 0;
        keys.special_codes[SpecialCodeIndex::VTIME] = 0;
        tcsetattr(&stdin, OptionalActions::Now, &keys)
            .map_err(|error| refused(&error.to_string()))?;
        Ok(Self {
            stdin,
            before,
            decoder: Decoder::default(),
        })
    }

    /// The keys since the last look. Never waits. Who puts the supervisor into the
    /// background gives back.
    pub fn read(&mut self) -> Vec<Key> {
        // A read from the background would stop the supervisor.
        if !is_in_foreground(&self.stdin) {
            self.decoder = Decoder::default();
            return vec![Key::GiveBack];
        }
        let mut bytes = [0; READ_MAX];
        let count = match is_readable(&self.stdin) {
            true => rustix::io::read(&self.stdin, &mut bytes).unwrap_or(0),
            false => 0,
        };
        self.decoder.decode(&bytes[..count])
    }
}

impl Drop for Keyboard {
    fn drop(&mut self) {
        // In the background the terminal is somebody else's, and as they want it.
        if is_in_foreground(&self.stdin) {
            // Keys that nobody read are not for the shell.
            let _ = tcsetattr(&self.stdin, OptionalActions::Flush, &self.before);
        }
    }
}

fn is_in_foreground(stdin: &Stdin) -> bool {
    tcgetpgrp(stdin).is_ok_and(|group| group == getpgrp())
}

/// Asked before each read: another program may have set the terminal so that
/// reads wait for a line.
fn is_readable(stdin: &Stdin) -> bool {
    let mut stdin = [PollFd::new(stdin, PollFlags::IN)];
    let no_time = Timespec {
        tv_sec: 0,
        tv_nsec: 0,
    };
    poll(&mut stdin, Some(&no_time)).is_ok_and(|ready| ready > 0)
}

/// Bytes of a terminal in, keys out.
#[derive(Debug, Default)]
pub struct Decoder {
    within: Within,
}

/// Where in an escape sequence the bytes are.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
enum Within {
    #[default]
    Nothing,
    /// After Esc: the key itself, or the begin of another's sequence.
    Escape,
    /// After `Esc [` or `Esc O`.
    Sequence,
}

impl Decoder {
    /// The keys in what was read since the last look, which may be nothing: an Esc
    /// that nothing follows until the next look is the key Esc.
    pub fn decode(&mut self, bytes: &[u8]) -> Vec<Key> {
        if bytes.is_empty() && self.within == Within::Escape {
            self.within = Within::Nothing;
            return vec![Key::GiveBack];
        }
        bytes.iter().filter_map(|byte| self.take(*byte)).collect()
    }

    fn take(&mut self, byte: u8) -> Option<Key> {
        let (within, key) = match (self.within, byte) {
            (Within::Escape, b'[' | b'O') => (Within::Sequence, None),
            // Esc twice, or a key pressed with Alt: neither is meant to drive.
            (Within::Escape, 0x1b) => (Within::Escape, Some(Key::GiveBack)),
            (Within::Escape, _) => (Within::Nothing, Some(Key::GiveBack)),
            (_, 0x1b) => (Within::Escape, None),
            // Numbers before the last byte tell of Shift and the like.
            (Within::Sequence, 0x20..=0x3f) => (Within::Sequence, None),
            (Within::Sequence, byte) => (Within::Nothing, arrow(byte)),
            (Within::Nothing, byte) => (Within::Nothing, plain(byte)),
        };
        self.within = within;
        key
    }
}

fn arrow(byte: u8) -> Option<Key> {
    match byte {
        b'A' => Some(Key::Gas),
        b'B' => Some(Key::Brake),
        b'C' => Some(Key::Right),
        b'D' => Some(Key::Left),
        _ => None,
    }
}

fn plain(byte: u8) -> Option<Key> {
    match byte.to_ascii_lowercase() {
        b' ' => Some(Key::Switch),
        b'q' => Some(Key::GiveBack),
        b'w' => Some(Key::Gas),
        b's' => Some(Key::Brake),
        b'a' => Some(Key::Left),
        b'd' => Some(Key::Right),
        _ => None,
    }
}
