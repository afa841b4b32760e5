//! The identities of server and client, and how their messages are protected. The certificate of the server is pinned: exactly one
//! is accepted, and it comes from a file that the operator has placed there, never from the network.

use opcua::client::{IdentityToken, Password};
use opcua::crypto::{CertificateStore, SecurityPolicy, X509};
use opcua::types::MessageSecurityMode;
use serde::{Deserialize, Serialize};

use std::path::{Path, PathBuf};

use std::{env, fs};

/// Security settings that cannot be used. Never contains a password.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SecurityError {
    /// Encryption without a trusted certificate.
    #[error("security.policy needs security.server_certificate: the file of the one certificate that is accepted")]
    NobodyTrusted,
    /// A certificate that would not be used.
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
        /// The cause.
        cause: String,
    },
    /// The certificate cannot be read.
    #[error("the server's certificate cannot be read from {}: {cause}", file.display())]
    CertificateUnreadable {
        /// As configured.
        file: PathBuf,
        /// The cause.
        cause: String,
    },
}

/// Where our key lies in the service's data folder.
const PKI_FOLDER: &str = "opcua";
/// The greatest size of a password file.
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
    pub(super) fn check(&self) -> Result<(), SecurityError> {
        let open = self.policy == Policy::None;
        let passwords_count = u8::from(self.password_file.is_some()) + u8::from(self.password_variable.is_some());
        if !open && self.server_certificate.is_none() {
            Err(SecurityError::NobodyTrusted)
        } else if open && self.server_certificate.is_some() {
            Err(SecurityError::TrustWithoutPolicy)
        } else if passwords_count != u8::from(self.user.is_some()) {
            Err(SecurityError::Password)
        } else if open && self.user.is_some() {
            Err(SecurityError::OpenPassword)
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

    /// The identity of the client. Read again for every connection, so that a new password needs no restart.
    pub(super) fn identity(&self) -> Result<IdentityToken, SecurityError> {
        let Some(user) = &self.user else { return Ok(IdentityToken::Anonymous) };
        Ok(IdentityToken::UserName(user.clone(), Password(self.password()?)))
    }

    fn password(&self) -> Result<String, SecurityError> {
        let (place, text) = match (&self.password_file, &self.password_variable) {
            (Some(file), _) => {
                (file.display().to_string(), fs::read_to_string(file).map_err(|error| error.to_string()))
            }
            (None, Some(name)) => (name.clone(), env::var(name).map_err(|error| error.to_string())),
            (None, None) => return Err(SecurityError::Password),
        };
        let unreadable = |cause: String| SecurityError::PasswordUnreadable { place: place.clone(), cause };
        let text = text.map_err(unreadable)?;
        let line = text.trim_end_matches(['\r', '\n']);
        if line.is_empty() || line.len() > PASSWORD_BYTES_MAX || line.contains('\n') {
            return Err(unreadable(format!("it must be one line of 1 to {PASSWORD_BYTES_MAX} bytes")));
        }
        Ok(line.to_owned())
    }

    /// The one certificate that is accepted; none where messages are open.
    pub(super) fn trusted(&self) -> Result<Option<X509>, SecurityError> {
        self.server_certificate.as_deref().map(read_certificate).transpose()
    }
}

fn read_certificate(file: &Path) -> Result<X509, SecurityError> {
    CertificateStore::read_cert(file)
        .map_err(|cause| SecurityError::CertificateUnreadable { file: file.to_path_buf(), cause })
}

/// How messages are protected, and the identity of the client.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Security {
    /// How messages are signed and encrypted.
    pub policy: Policy,
    /// The server's certificate, .der or .pem. No other is accepted. Needed where there is a policy.
    pub server_certificate: Option<PathBuf>,
    /// Name by which we log in; anonymous where there is none.
    pub user: Option<String>,
    /// File with the password, one line.
    pub password_file: Option<PathBuf>,
    /// Variable of the environment with the password.
    pub password_variable: Option<String>,
    /// Folder of our own key and certificate (own/cert.der, which the server must trust); made where it is missing. The
    /// service's data folder has one unless configured otherwise.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pki: Option<PathBuf>,
}

/// How messages are signed and encrypted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Policy {
    /// Not at all.
    #[default]
    None,
    /// Signed and encrypted.
    Basic256Sha256,
    /// Signed and encrypted.
    Aes256Sha256RsaPss,
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
            (Security { server_certificate: None, ..secured() }, SecurityError::NobodyTrusted),
            (Security { policy: Policy::None, ..secured() }, SecurityError::TrustWithoutPolicy),
            (Security { policy: Policy::None, server_certificate: None, ..secured() }, SecurityError::OpenPassword),
            (Security { password_variable: None, ..secured() }, SecurityError::Password),
            (Security { password_file: Some("p".into()), ..secured() }, SecurityError::Password),
            (Security { user: None, ..secured() }, SecurityError::Password),
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
