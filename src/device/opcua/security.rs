//! The identities of server and client, and the protection of their messages. The certificate of the server is pinned: exactly one
//! is accepted, and it comes from a file that the operator has installed, never from the network.

use opcua::client::{IdentityToken, Password};
use opcua::crypto::{CertificateStore, SecurityPolicy, X509};
use opcua::types::MessageSecurityMode;
use serde::{Deserialize, Serialize};

use std::path::{Path, PathBuf};

use std::{env, fs};

/// Invalid security settings. The messages never contain a password.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SecurityError {
    /// Encryption is configured without a trusted certificate.
    #[error("security.policy needs security.server_certificate: the file of the one certificate that is accepted")]
    NobodyTrusted,
    /// A certificate is configured that would not be used.
    #[error("security.server_certificate needs a security.policy other than none")]
    TrustWithoutPolicy,
    /// A password would be sent without encryption.
    #[error("security.user needs a security.policy other than none: the password would be readable on the network")]
    OpenPassword,
    /// A user has no password, or a password has no user.
    #[error(
        "security.user needs exactly one of security.password_file and security.password_variable, and these need security.user"
    )]
    Password,
    /// The password cannot be read.
    #[error("the password cannot be read from {place}: {cause}")]
    PasswordUnreadable {
        /// The file or variable.
        place: String,
        /// The cause.
        cause: String,
    },
    /// The certificate cannot be read.
    #[error("the server's certificate cannot be read from {}: {cause}", file.display())]
    CertificateUnreadable {
        /// The configured file.
        file: PathBuf,
        /// The cause.
        cause: String,
    },
}

/// Folder of the client's key in the service's data folder.
const PKI_FOLDER: &str = "opcua";
/// The greatest size of a password file.
const PASSWORD_BYTES_MAX: usize = 1024;

impl Policy {
    /// The policy as the library defines it.
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

    /// Keeps the client's key below this folder if the configuration names no other.
    pub fn keep_below(&mut self, data: &Path) {
        self.pki.get_or_insert_with(|| data.join(PKI_FOLDER));
    }

    /// The folder of the client's key.
    pub(super) fn pki(&self) -> PathBuf {
        self.pki.clone().unwrap_or_else(|| Path::new("data").join(PKI_FOLDER))
    }

    /// The identity of the client. It is read again for every connection, so that a new password needs no restart.
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

    /// The only accepted certificate; `None` if messages are not encrypted.
    pub(super) fn trusted(&self) -> Result<Option<X509>, SecurityError> {
        self.server_certificate.as_deref().map(read_certificate).transpose()
    }
}

fn read_certificate(file: &Path) -> Result<X509, SecurityError> {
    CertificateStore::read_cert(file)
        .map_err(|cause| SecurityError::CertificateUnreadable { file: file.to_path_buf(), cause })
}

/// The protection of messages, and the identity of the client.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Security {
    /// Signing and encryption of messages.
    pub policy: Policy,
    /// The server's certificate, .der or .pem. No other is accepted. It is required with a policy other than none.
    pub server_certificate: Option<PathBuf>,
    /// User name; if it is missing, the client is anonymous.
    pub user: Option<String>,
    /// File with the password, one line.
    pub password_file: Option<PathBuf>,
    /// Environment variable with the password.
    pub password_variable: Option<String>,
    /// Folder of the client's key and certificate (own/cert.der, which the server must trust); created if it is missing. By default
    /// it is in the service's data folder.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pki: Option<PathBuf>,
}

/// Signing and encryption of messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Policy {
    /// Neither signed nor encrypted.
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
    fn incomplete_security_settings_are_refused() {
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
    fn an_unreadable_password_is_reported_with_its_source() {
        let nowhere = Security { password_variable: Some("COAXIS_NO_SUCH_VARIABLE".into()), ..secured() };
        let trouble = nowhere.identity().expect_err("no password").to_string();
        assert!(trouble.contains("COAXIS_NO_SUCH_VARIABLE"), "{trouble}");
    }
}
