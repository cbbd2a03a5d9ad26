using System;
using Google.Protobuf.WellKnownTypes;

namespace Pliant
{
    /// <summary>Kinds of failures, with the numbers of gRPC.</summary>
    public enum StatusCode
    {
        Ok = 0,
        Cancelled = 1,
        Unknown = 2,
        InvalidArgument = 3,
        DeadlineExceeded = 4,
        NotFound = 5,
        AlreadyExists = 6,
        PermissionDenied = 7,
        ResourceExhausted = 8,
        FailedPrecondition = 9,
        Aborted = 10,
        OutOfRange = 11,
        Unimplemented = 12,
        Internal = 13,
        Unavailable = 14,
        DataLoss = 15,
        Unauthenticated = 16,
    }

    /// <summary>A call that failed: what the server saw and what it allows.</summary>
    public sealed class PliantException : Exception
    {
        public StatusCode Code { get; }

        public PliantException(StatusCode code, string message) : base(message) => Code = code;

        /// <summary>What an HTTP answer with a problem document says.</summary>
        internal static PliantException OfProblem(int status, string text)
        {
            try
            {
                var fields = Struct.Parser.ParseJson(text).Fields;
                var name = fields["code"].StringValue.Replace("_", "");
                var code = System.Enum.TryParse(name, true, out StatusCode known) ? known : StatusCode.Unknown;
                return new PliantException(code, fields["detail"].StringValue);
            }
            catch (Exception)
            {
                return new PliantException(StatusCode.Unknown, $"the server answered {status} without a reason");
            }
        }
    }
}
