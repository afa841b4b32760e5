//! Who the server is, who we are, and how messages between us are protected. Certificates are pinned: exactly one is accepted,
//! and it comes from a file that somebody put there, never from the network.

use super::settings::{Policy, Security};
use opcua::client::{IdentityToken, Password};
use opcua::crypto::{CertificateStore, SecurityPolicy, X509};
use opcua::types::MessageSecurityMode;
use std::env;
use std::fs;
use std::path::{Path, PathBuf};

/// Security that is none, or that cannot be had. Never holds a password.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Trouble {
    /// Encryption with nobody known.
    #[error("security.policy needs security.server_certificate: the file of the one certificate that is accepted")]
    NobodyTrusted,
    /// A certificate that nobody would look at.
    #[error("security.server_certificate needs a security.policy other than none")]
    TrustWithoutPolicy,
    /// A password over an open line.
    #[error("security.user needs a security.policy other than none: the password would be readable on the network")]
    OpenPassword,
    /// A user without a password, or a password without a user.
    #[error(
        "security.user goes with exactly one of security.password_file and security.password_variable, and they with it"
    )]
    Password,
    /// The password cannot be read.
    #[error("the password cannot be read from {place}: {cause}")]
    PasswordUnreadable {
        /// File or variable.
        place: String,
        /// What was said.
        cause: String,
    },
    /// The certificate cannot be read.
    #[error("the server's certificate cannot be read from {}: {cause}", file.display())]
    CertificateUnreadable {
        /// As configured.
        file: PathBuf,
        /// What was said.
        cause: String,
    },
}

/// Where our key lies in the service's data folder.
const PKI_FOLDER: &str = "opcua";
/// The most that a file of a password may hold.
const PASSWORD_BYTES_MAX: usize = 1024;

impl Policy {
    /// As the library knows it.
    pub(super) const fn library(self) -> SecurityPolicy {
        match self {
            Self::None => SecurityPolicy::None,
            Self::Basic256Sha256 => SecurityPolicy::Basic256Sha256,
            Self::Aes256Sha256RsaPss => SecurityPolicy::Aes256Sha256RsaPss,
        }
    }

    /// Protected messages are always signed and encrypted.
    pub(super) const fn mode(self) -> MessageSecurityMode {
        match self {
            Self::None => MessageSecurityMode::None,
            Self::Basic256Sha256 | Self::Aes256Sha256RsaPss => MessageSecurityMode::SignAndEncrypt,
        }
    }
}

impl Security {
    pub(super) fn check(&self) -> Result<(), Trouble> {
        let open = self.policy == Policy::None;
        let passwords_count = u8::from(self.password_file.is_some()) + u8::from(self.password_variable.is_some());
        if !open && self.server_certificate.is_none() {
            Err(Trouble::NobodyTrusted)
        } else if open && self.server_certificate.is_some() {
            Err(Trouble::TrustWithoutPolicy)
        } else if passwords_count != u8::from(self.user.is_some()) {
            Err(Trouble::Password)
        } else if open && self.user.is_some() {
            Err(Trouble::OpenPassword)
        } else {
            Ok(())
        }
    }

    /// Keeps our key below this folder where the configuration names no other.
    pub fn keep_below(&mut self, data: &Path) {
        self.pki.get_or_insert_with(|| data.join(PKI_FOLDER));
    }

    /// The folder of our key.
    pub(super) fn pki(&self) -> PathBuf {
        self.pki.clone().unwrap_or_else(|| Path::new("data").join(PKI_FOLDER))
    }

    /// Who we say we are. Read anew at every connection, so that a new password needs no restart.
    pub(super) fn identity(&self) -> Result<IdentityToken, Trouble> {
        let Some(user) = &self.user else { return Ok(IdentityToken::Anonymous) };
        Ok(IdentityToken::UserName(user.clone(), Password(self.password()?)))
    }

    fn password(&self) -> Result<String, Trouble> {
        let (place, text) = match (&self.password_file, &self.password_variable) {
            (Some(file), _) => {
                (file.display().to_string(), fs::read_to_string(file).map_err(|error| error.to_string()))
            }
            (None, Some(name)) => (name.clone(), env::var(name).map_err(|error| error.to_string())),
            (None, None) => return Err(Trouble::Password),
        };
        let unreadable = |cause: String| Trouble::PasswordUnreadable { place: place.clone(), cause };
        let text = text.map_err(unreadable)?;
        let line = text.trim_end_matches(['\r', '\n']);
        if line.is_empty() || line.len() > PASSWORD_BYTES_MAX || line.contains('\n') {
            return Err(unreadable(format!("it must be one line of 1 to {PASSWORD_BYTES_MAX} bytes")));
        }
        Ok(line.to_owned())
    }

    /// The one certificate that is accepted; none where messages are open.
    pub(super) fn trusted(&self) -> Result<Option<X509>, Trouble> {
        self.server_certificate.as_deref().map(read_certificate).transpose()
    }
}

fn read_certificate(file: &Path) -> Result<X509, Trouble> {
    CertificateStore::read_cert(file)
        .map_err(|cause| Trouble::CertificateUnreadable { file: file.to_path_buf(), cause })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn secured() -> Security {
        Security {
            policy: Policy::Basic256Sha256,
            server_certificate: Some("plc.der".into()),
            user: Some("coaxis".into()),
            password_variable: Some("PLC_PASSWORD".into()),
            ..Security::default()
        }
    }

    #[test]
    fn half_a_security_is_none() {
        assert_eq!((Security::default().check(), secured().check()), (Ok(()), Ok(())));
        let cases = [
            (Security { server_certificate: None, ..secured() }, Trouble::NobodyTrusted),
            (Security { policy: Policy::None, ..secured() }, Trouble::TrustWithoutPolicy),
            (Security { policy: Policy::None, server_certificate: None, ..secured() }, Trouble::OpenPassword),
            (Security { password_variable: None, ..secured() }, Trouble::Password),
            (Security { password_file: Some("p".into()), ..secured() }, Trouble::Password),
            (Security { user: None, ..secured() }, Trouble::Password),
        ];
        for (security, trouble) in cases {
            assert_eq!(security.check(), Err(trouble));
        }
    }

    #[test]
    fn a_password_that_cannot_be_read_is_named_by_its_place() {
        let nowhere = Security { password_variable: Some("COAXIS_NO_SUCH_VARIABLE".into()), ..secured() };
        let trouble = nowhere.identity().expect_err("no password").to_string();
        assert!(trouble.contains("COAXIS_NO_SUCH_VARIABLE"), "{trouble}");
    }
}
