// What Google.Protobuf calls of System.Runtime.CompilerServices.Unsafe, which Mono keeps to itself. For tests alone.
using System;
using System.Runtime.InteropServices;

namespace Google.Protobuf
{
    static unsafe class Unsafe
    {
        internal static ref byte Add(ref byte source, int offset)
        {
            fixed (byte* at = &source) return ref at[offset];
        }

        internal static ref byte AddByteOffset(ref byte source, IntPtr offset)
        {
            fixed (byte* at = &source) return ref at[(long)offset];
        }

        internal static ref char AddByteOffset(ref char source, IntPtr offset)
        {
            fixed (char* at = &source) return ref at[(long)offset / sizeof(char)];
        }

        internal static ref byte As<From, To>(ref char source)
        {
            fixed (char* at = &source) return ref ((byte*)at)[0];
        }

        internal static T ReadUnaligned<T>(ref byte source) where T : struct
        {
            fixed (byte* at = &source) return MemoryMarshal.Read<T>(new ReadOnlySpan<byte>(at, Marshal.SizeOf<T>()));
        }

        internal static void WriteUnaligned<T>(ref byte target, T value) where T : struct
        {
            fixed (byte* at = &target) MemoryMarshal.Write(new Span<byte>(at, Marshal.SizeOf<T>()), ref value);
        }
    }
}
